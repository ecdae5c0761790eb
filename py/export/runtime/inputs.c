#include "history.h"
#include "internal.h"

/* ---- inputs as the equations see them ---- */

double ht_dead_time(const ht_instance *s, size_t k) {
    double td = ht_values(s, HT_PARAMETER)[s->model->dead_time[k]];
    return td > 0.0 ? td : 0.0;
}

/* Inputs at `time`, which is not before the communication point. Slopes may be NULL. */
void ht_inputs_at(const ht_instance *s, double time, double *u, double *du) {
    size_t k;
    double now = ht_time(s);
    for (k = 0; k < s->model->inputs; k++) {
        const double *history = ht_history_of(s, k);
        double seen = history ? time - ht_dead_time(s, k) : time, slope = ht_slopes(s)[k];
        u[k] = ht_values(s, HT_INPUT)[k] + slope * (seen - now);
        if (history && seen < now) {
            if (history[0] > 0.0) {
                ht_history_at(history, s->model->history, seen, &u[k], &slope);
            } else {
                u[k] = ht_values(s, HT_INPUT)[k];
            }
        }
        if (du) du[k] = slope;
    }
}

void ht_inputs_mean(const ht_instance *s, double from, double to, double *u) {
    size_t k;
    for (k = 0; k < s->model->inputs; k++) {
        const double *history = ht_history_of(s, k);
        if (history) {
            double td = ht_dead_time(s, k);
            u[k] = ht_history_mean(history, s->model->history, from - td, to - td);
        } else {
            u[k] = ht_values(s, HT_INPUT)[k] + ht_slopes(s)[k] * (0.5 * (from + to) - ht_time(s));
        }
    }
}

double ht_inputs_jump(const ht_instance *s, double from, double to) {
    size_t k;
    double first = to;
    for (k = 0; k < s->model->inputs; k++) {
        const double *history = ht_history_of(s, k);
        if (history) {
            double td = ht_dead_time(s, k), seen = ht_history_jump(history, s->model->history, from - td, to - td);
            if (seen < to - td && seen + td < first) first = seen + td;
        }
    }
    return first;
}

void ht_remember_inputs(ht_instance *s) {
    size_t k;
    double now = ht_time(s);
    for (k = 0; k < s->model->inputs; k++) {
        double *history = ht_history_of(s, k);
        if (history)
            ht_history_push(history, s->model->history, now, ht_values(s, HT_INPUT)[k], ht_slopes(s)[k], now - ht_dead_time(s, k));
    }
}

int ht_inputs_steady(const ht_instance *s) {
    size_t k;
    for (k = 0; k < s->model->inputs; k++)
        if (ht_slopes(s)[k] != 0.0 || s->model->dead_time[k] >= 0) return 0;
    return 1;
}

