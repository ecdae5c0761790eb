/* Shared by the files of the core; no face includes it. */
#ifndef HT_INTERNAL_H
#define HT_INTERNAL_H

#include "core.h"

#define HT_NEAR 1e-9 /* relative: two times this close are one */
#define HT_SLACK 1e-6 /* of a sample period: a sample this near is due */

/* bookkeeping inside the flat state */
enum { PHASE, STALE, RATES_STALE, START_TIME, STOP_DEFINED, STOP_TIME, SAMPLE, INTERFACE, OUTSIDE, ASKED, MOVED, BOOKKEEPING };

/* core.c */
size_t ht_place_of(const ht_model *model, ht_kind kind);
size_t ht_scratch_doubles(const ht_model *model);
double *ht_values(const ht_instance *self, ht_kind kind);
double *ht_slopes(const ht_instance *self);
double *ht_asked(const ht_instance *self); /* the inputs with which derivatives were asked for last */
double *ht_starts(const ht_instance *self); /* as the equations get them: what nobody set may follow from the rest */
double *ht_book(const ht_instance *self);
double *ht_history_of(const ht_instance *self, size_t input); /* NULL when the input is not delayed */
ht_status ht_fail(ht_instance *self, ht_status status, const char *format, ...);
double ht_pause(ht_instance *self, double time, double end); /* let the watcher see `time`; returns the new end */
ht_status ht_expect(ht_instance *self, ht_phase phase, const char *what);
int ht_finite(const double *values, size_t n);

/* inputs.c: inputs as the equations see them */
double ht_dead_time(const ht_instance *self, size_t input);
void ht_inputs_at(const ht_instance *self, double time, double *u, double *slope); /* slope may be NULL */
void ht_inputs_mean(const ht_instance *self, double from, double to, double *u);
/* where a delayed input jumps first behind `from`, else `to`: a step ends there */
double ht_inputs_jump(const ht_instance *self, double from, double to);
int ht_inputs_steady(const ht_instance *self); /* constant until the next communication point */
void ht_remember_inputs(ht_instance *self);

/* solve.c */
int ht_call(ht_instance *self, ht_function f, size_t args, const double *const *arg, size_t ress, double *const *res);
/* from `time` by `size` to *end; a watcher may want *end earlier */
ht_status ht_integrate(ht_instance *self, double time, double size, double *end);
ht_status ht_sample_through(ht_instance *self, double time, double size, double *end);
double ht_sample_time(const ht_instance *self); /* of the sample that is due next */
ht_status ht_refresh(ht_instance *self);        /* outputs of the present state, in Model Exchange its derivatives too */
ht_status ht_refresh_rates(ht_instance *self);  /* derivatives, where outputs alone were asked for so far */

/* sensitivity.c: whether the present phase has them; if not, the message says so */
int ht_has_derivatives(ht_instance *self);

#endif
