/* What a delayed input has been: a ring of pieces (time, value, slope) inside the flat state. */
#ifndef HT_HISTORY_H
#define HT_HISTORY_H

#include "core.h"

#define HT_PIECE 3

/* doubles that one history of `pieces` pieces takes: count, place of the newest, the pieces */
size_t ht_history_doubles(size_t pieces);
void ht_history_clear(double *history);
/* from `time` on the input is value + slope (t - time); what is older than `horizon` may be forgotten */
void ht_history_push(double *history, size_t capacity, double time, double value, double slope, double horizon);
/* value and slope at `time`; before the first piece the first value */
void ht_history_at(const double *history, size_t capacity, double time, double *value, double *slope);
/* mean over [from, to], from < to */
double ht_history_mean(const double *history, size_t capacity, double from, double to);
/* where the value jumps first behind `from` and before `to`, else `to` */
double ht_history_jump(const double *history, size_t capacity, double from, double to);

#endif
