#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "history.h"
#include "internal.h"

/* ---- places in the flat state ---- */

static size_t block_size(const ht_model *m, ht_kind kind) {
    switch (kind) {
        case HT_INPUT: return m->inputs;
        case HT_PARAMETER: return m->parameters;
        case HT_START: return m->starts;
        case HT_OUTPUT: return m->outputs;
        case HT_STATE: return m->states;
        case HT_DERIVATIVE: return m->derivatives;
        case HT_TIME: return 1;
        default: return 0;
    }
}

size_t ht_place_of(const ht_model *m, ht_kind kind) {
    size_t sum = 0;
    int k;
    for (k = 0; k < (int)kind; k++) sum += block_size(m, (ht_kind)k);
    return sum;
}

size_t ht_variables(const ht_model *m) { return ht_place_of(m, HT_UNKNOWN); }

ht_kind ht_kind_of(const ht_model *m, size_t reference, size_t *index) {
    int k;
    for (k = 0; k < (int)HT_UNKNOWN; k++) {
        size_t size = block_size(m, (ht_kind)k);
        if (reference < size) {
            if (k == HT_TIME && !m->time_listed) return HT_UNKNOWN;
            if (index) *index = reference;
            return (ht_kind)k;
        }
        reference -= size;
    }
    return HT_UNKNOWN;
}

double *ht_values(const ht_instance *s, ht_kind kind) { return s->data + s->place[kind]; }
double *ht_slopes(const ht_instance *s) { return s->data + s->place[HT_UNKNOWN]; }
double *ht_asked(const ht_instance *s) { return ht_slopes(s) + s->model->inputs; }
double *ht_starts(const ht_instance *s) { return ht_asked(s) + s->model->inputs; }
double *ht_book(const ht_instance *s) { return ht_starts(s) + s->model->starts; }

static size_t delayed_inputs(const ht_model *m) {
    size_t k, n = 0;
    for (k = 0; k < m->inputs; k++) n += m->dead_time[k] >= 0;
    return n;
}

/* the history of input k, NULL when it is not delayed */
double *ht_history_of(const ht_instance *s, size_t k) {
    size_t j, before = 0;
    if (s->model->dead_time[k] < 0) return NULL;
    for (j = 0; j < k; j++) before += s->model->dead_time[j] >= 0;
    return ht_book(s) + BOOKKEEPING + before * ht_history_doubles(s->model->history);
}

size_t ht_doubles(const ht_model *m) {
    return ht_variables(m) + 2 * m->inputs + m->starts + BOOKKEEPING + delayed_inputs(m) * ht_history_doubles(m->history);
}

size_t ht_scratch_doubles(const ht_model *m) {
    return 8 * m->states + 4 * m->inputs + 2 * m->parameters + m->starts + 2 * m->outputs + m->derivatives;
}

size_t ht_bytes(const ht_model *m) {
    return (2 * ht_doubles(m) + ht_scratch_doubles(m) + m->size_w) * sizeof(double) + m->size_arg * sizeof(double *) +
           m->size_res * sizeof(double *) + m->size_iw * sizeof(long long);
}

void ht_place(ht_instance *s, const ht_model *m, ht_interface interface, void *memory) {
    int k;
    for (k = 0; k <= (int)HT_UNKNOWN; k++) s->place[k] = ht_place_of(m, (ht_kind)k);
    s->model = m;
    s->interface = interface;
    s->data = (double *)memory;
    s->backup = s->data + ht_doubles(m);
    s->scratch = s->backup + ht_doubles(m);
    s->w = s->scratch + ht_scratch_doubles(m);
    s->iw = (long long *)(s->w + m->size_w);
    s->arg = (const double **)(s->iw + m->size_iw);
    s->res = (double **)(s->arg + m->size_arg);
    ht_reset(s);
}

void ht_reset(ht_instance *s) {
    const ht_model *m = s->model;
    memset(s->data, 0, ht_doubles(m) * sizeof(double));
    memcpy(s->data, m->defaults, (m->inputs + m->parameters + m->starts) * sizeof(double));
    memcpy(ht_starts(s), m->unset, m->starts * sizeof(double));
    ht_book(s)[PHASE] = HT_INSTANTIATED;
    ht_book(s)[STALE] = 1.0;
    ht_book(s)[INTERFACE] = s->interface;
    s->message[0] = 0;
}

ht_phase ht_phase_of(const ht_instance *s) { return (ht_phase)(int)ht_book(s)[PHASE]; }
double ht_time(const ht_instance *s) { return ht_values(s, HT_TIME)[0]; }

ht_status ht_fail(ht_instance *s, ht_status status, const char *format, ...) {
    va_list list;
    va_start(list, format);
    vsnprintf(s->message, sizeof s->message, format, list);
    va_end(list);
    return status;
}

int ht_finite(const double *v, size_t n) {
    size_t k;
    for (k = 0; k < n; k++)
        if (!(fabs(v[k]) <= 1.7e308)) return 0;
    return 1;
}

/* ---- phases ---- */

ht_status ht_expect(ht_instance *s, ht_phase phase, const char *what) {
    static const char *const names[] = {"instantiated", "in initialization mode", "running",
                                        "terminated",   "in event mode",          "in continuous-time mode",
                                        "in intermediate update mode"};
    if (ht_phase_of(s) == phase) return HT_OK;
    return ht_fail(s, HT_ERROR, "%s is not allowed while the instance is %s", what, names[ht_phase_of(s)]);
}

ht_status ht_setup(ht_instance *s, double start, int stop_defined, double stop) {
    if (ht_expect(s, HT_INSTANTIATED, "setting up the experiment") != HT_OK) return HT_ERROR;
    if (!ht_finite(&start, 1) || (stop_defined && !(stop >= start)))
        return ht_fail(s, HT_ERROR, "the experiment cannot run from %g s to %g s", start, stop);
    ht_values(s, HT_TIME)[0] = ht_book(s)[START_TIME] = start;
    ht_book(s)[STOP_DEFINED] = stop_defined ? 1.0 : 0.0;
    ht_book(s)[STOP_TIME] = stop_defined ? stop : 0.0;
    return HT_OK;
}

ht_status ht_enter_initialisation(ht_instance *s) {
    if (ht_expect(s, HT_INSTANTIATED, "entering initialization mode") != HT_OK) return HT_ERROR;
    ht_book(s)[PHASE] = HT_INITIALISING;
    return HT_OK;
}

ht_status ht_exit_initialisation(ht_instance *s) {
    ht_status status;
    if (ht_expect(s, HT_INITIALISING, "leaving initialization mode") != HT_OK) return HT_ERROR;
    ht_book(s)[STALE] = 1.0;
    status = ht_refresh(s);
    if (status != HT_OK) return HT_ERROR;
    ht_book(s)[PHASE] = s->interface == HT_MODEL_EXCHANGE ? HT_EVENT : HT_RUNNING;
    return HT_OK;
}

ht_status ht_terminate(ht_instance *s) {
    ht_phase phase = ht_phase_of(s);
    if (phase != HT_EVENT && phase != HT_CONTINUOUS && ht_expect(s, HT_RUNNING, "terminating") != HT_OK) return HT_ERROR;
    ht_book(s)[PHASE] = HT_TERMINATED;
    return HT_OK;
}

/* ---- variables ---- */

static int settable(ht_kind kind, ht_phase phase) {
    switch (phase) {
        case HT_INSTANTIATED:
        case HT_INITIALISING: return kind <= HT_START;
        case HT_RUNNING: return kind <= HT_PARAMETER;
        case HT_BETWEEN: return kind == HT_INPUT;
        case HT_EVENT:
        case HT_CONTINUOUS: /* tunable parameters too, beyond the standard: optimisers move them without an event */
            return kind <= HT_PARAMETER || kind == HT_STATE;
        default: return 0;
    }
}

static ht_status may_set(ht_instance *s, size_t reference) {
    ht_kind kind = ht_kind_of(s->model, reference, NULL);
    if (kind == HT_UNKNOWN) return ht_fail(s, HT_ERROR, "no variable has the value reference %lu", (unsigned long)reference);
    if (!settable(kind, ht_phase_of(s)))
        return ht_fail(s, HT_ERROR, "variable '%s' cannot be set now", s->model->labels[reference]);
    return HT_OK;
}

ht_status ht_set(ht_instance *s, const unsigned *reference, size_t n, const double *value) {
    size_t k, i = 0;
    for (k = 0; k < n; k++) {
        if (may_set(s, reference[k]) != HT_OK) return HT_ERROR;
        if (!ht_finite(value + k, 1))
            return ht_fail(s, HT_DISCARD, "variable '%s' cannot take the value %g", s->model->labels[reference[k]], value[k]);
    }
    for (k = 0; k < n; k++) {
        s->data[reference[k]] = value[k];
        if (ht_kind_of(s->model, reference[k], &i) == HT_START) ht_starts(s)[i] = value[k];
    }
    ht_book(s)[STALE] = 1.0;
    return HT_OK;
}

ht_status ht_get(ht_instance *s, const unsigned *reference, size_t n, double *value) {
    size_t k;
    int follows = 0, rates = 0;
    if (ht_phase_of(s) == HT_INSTANTIATED)
        return ht_fail(s, HT_ERROR, "values cannot be read before initialization mode");
    for (k = 0; k < n; k++) {
        ht_kind kind = ht_kind_of(s->model, reference[k], NULL);
        if (kind == HT_UNKNOWN) return ht_fail(s, HT_ERROR, "no variable has the value reference %u", reference[k]);
        if (ht_phase_of(s) == HT_BETWEEN && !ht_between(s->model, reference[k]))
            return ht_fail(s, HT_ERROR, "variable '%s' cannot be read inside a step", s->model->labels[reference[k]]);
        follows = follows || (kind >= HT_OUTPUT && kind <= HT_DERIVATIVE);
        rates = rates || kind == HT_DERIVATIVE;
    }
    if (follows && ht_phase_of(s) != HT_TERMINATED) {
        ht_status status = ht_refresh(s);
        if (status == HT_OK && rates) status = ht_refresh_rates(s);
        if (status != HT_OK) return status;
    }
    for (k = 0; k < n; k++) value[k] = s->data[reference[k]];
    return HT_OK;
}

ht_status ht_set_slope(ht_instance *s, const unsigned *reference, size_t n, const double *slope) {
    size_t k;
    if (ht_phase_of(s) == HT_TERMINATED) return ht_fail(s, HT_ERROR, "the instance is terminated");
    for (k = 0; k < n; k++) {
        if (ht_kind_of(s->model, reference[k], NULL) != HT_INPUT)
            return ht_fail(s, HT_ERROR, "value reference %u is not an input", reference[k]);
        if (!ht_finite(slope + k, 1)) return ht_fail(s, HT_DISCARD, "an input derivative cannot be %g", slope[k]);
    }
    for (k = 0; k < n; k++) ht_slopes(s)[reference[k]] = slope[k];
    return HT_OK;
}

/* ---- one communication step ---- */

static ht_status check_step(ht_instance *s, double time, double size) {
    double now = ht_time(s), near = HT_NEAR * (1.0 + fabs(now)) + 1e-6 * fabs(size);
    if (ht_expect(s, HT_RUNNING, "a step") != HT_OK) return HT_ERROR;
    if (!ht_finite(&time, 1) || !(size > 0.0) || !ht_finite(&size, 1))
        return ht_fail(s, HT_ERROR, "a step from t = %g s of size %g s is not possible", time, size);
    if (fabs(time - now) > near)
        return ht_fail(s, HT_ERROR, "the step starts at t = %.12g s, the instance is at %.12g s", time, now);
    if (ht_book(s)[STOP_DEFINED] != 0.0 && time + size > ht_book(s)[STOP_TIME] + near)
        return ht_fail(s, HT_ERROR, "the step ends at t = %.12g s, after the stop time %.12g s", time + size, ht_book(s)[STOP_TIME]);
    return HT_OK;
}

static void move_to(ht_instance *s, double time) {
    size_t k;
    for (k = 0; k < s->model->inputs; k++) ht_values(s, HT_INPUT)[k] += ht_slopes(s)[k] * (time - ht_time(s));
    ht_values(s, HT_TIME)[0] = time;
    ht_book(s)[STALE] = 1.0;
}

/* What is sampled changes at its samples and not for one who looks in between: only its inputs are at hand there. */
int ht_between(const ht_model *m, size_t reference) {
    ht_kind kind = ht_kind_of(m, reference, NULL);
    return kind == HT_INPUT || (kind == HT_OUTPUT && m->method != HT_SAMPLED);
}

double ht_pause(ht_instance *s, double time, double end) {
    if (!s->watcher) return end;
    move_to(s, time);
    ht_book(s)[PHASE] = HT_BETWEEN;
    end = s->watcher(s, end);
    ht_book(s)[PHASE] = HT_RUNNING;
    ht_remember_inputs(s);
    return end;
}

ht_status ht_step(ht_instance *s, double time, double size) {
    ht_status status = check_step(s, time, size);
    double end = time + size;
    s->left_domain = 0;
    if (status != HT_OK) return status;
    memcpy(s->backup, s->data, ht_doubles(s->model) * sizeof(double));
    ht_values(s, HT_TIME)[0] = time;
    ht_remember_inputs(s);
    status = s->model->method == HT_SAMPLED ? ht_sample_through(s, time, size, &end) : ht_integrate(s, time, size, &end);
    if (status == HT_OK) {
        move_to(s, end);
        memset(ht_slopes(s), 0, s->model->inputs * sizeof(double));
        if (s->left_domain) ht_fail(s, HT_OK, "the block left its training data at t = %.9g s: from there it guesses", s->left_at);
    } else {
        s->left_domain = 0;
        memcpy(s->data, s->backup, ht_doubles(s->model) * sizeof(double));
    }
    return status;
}

