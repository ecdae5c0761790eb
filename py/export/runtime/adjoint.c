#include <string.h>

#include "internal.h"

/* ---- adjoint derivatives: seeds on the unknowns, answers on the knowns ---- */

/* The transposed of delay_seeds in sensitivity.c: a delayed input answers to its dead time and to the clock. */
static void delay_answers(ht_instance *s, double *bar_t, double *bar_u, double *bar_p, const double *slope) {
    size_t k;
    for (k = 0; k < s->model->inputs; k++)
        if (s->model->dead_time[k] >= 0 && ht_phase_of(s) != HT_INITIALISING) {
            *bar_t += slope[k] * bar_u[k];
            bar_p[s->model->dead_time[k]] -= slope[k] * bar_u[k];
            if (ht_dead_time(s, k) > 0.0) bar_u[k] = 0.0;
        }
}

/* The states at the start follow from inputs, parameters and start parameters: pass their seeds on. */
static int pass_to_start(ht_instance *s, const double *bar_x, double *bar_u, double *bar_p, double *bar_z, double *more) {
    const ht_model *m = s->model;
    const double *arg[4];
    double *res[3];
    size_t k;
    res[0] = more, res[1] = more + m->inputs, res[2] = bar_z;
    arg[0] = ht_values(s, HT_INPUT), arg[1] = ht_values(s, HT_PARAMETER), arg[2] = ht_starts(s), arg[3] = bar_x;
    if (ht_call(s, m->start_reverse, 4, arg, 3, res)) return 1;
    for (k = 0; k < m->inputs; k++) bar_u[k] += res[0][k];
    for (k = 0; k < m->parameters; k++) bar_p[k] += res[1][k];
    return 0;
}

static ht_status read_seeds(ht_instance *s, const unsigned *unknown, size_t n, const double *seed, double *const to[]) {
    size_t k, i = 0;
    for (k = 0; k < n; k++) {
        ht_kind kind = ht_kind_of(s->model, unknown[k], &i);
        if (kind == HT_UNKNOWN || to[kind] == NULL)
            return ht_fail(s, HT_ERROR, "value reference %u has no derivative", unknown[k]);
        to[kind][i] += seed[k];
    }
    return HT_OK;
}

ht_status ht_adjoint(ht_instance *s, const unsigned *unknown, size_t unknowns, const unsigned *known, size_t knowns,
                     const double *seed, double *sensitivity) {
    const ht_model *m = s->model;
    double *seed_xdot = s->scratch, *seed_y = seed_xdot + m->derivatives, *seed_x = seed_y + m->outputs;
    double *bar_x = seed_x + m->states, *bar_u = bar_x + m->states, *bar_p = bar_u + m->inputs;
    double *bar_z = bar_p + m->parameters, *more = bar_z + m->starts, *u = more + m->inputs + m->parameters;
    double *slope = u + m->inputs, *to[HT_UNKNOWN] = {NULL}, *from[HT_UNKNOWN] = {NULL}, t = ht_time(s), bar_t = 0.0;
    const double *arg[6];
    double *res[4];
    size_t k, i = 0;
    int starting = ht_phase_of(s) == HT_INITIALISING;
    ht_status status;
    if (!ht_has_derivatives(s)) return HT_ERROR;
    status = ht_refresh(s);
    if (status != HT_OK) return status;
    memset(s->scratch, 0, ht_scratch_doubles(m) * sizeof(double));
    to[HT_OUTPUT] = seed_y, to[HT_DERIVATIVE] = seed_xdot, to[HT_STATE] = seed_x;
    if (read_seeds(s, unknown, unknowns, seed, to) != HT_OK) return HT_ERROR;
    if (m->method == HT_SAMPLED && ht_sample_time(s) > t + HT_SLACK * m->step)
        memset(seed_y, 0, m->outputs * sizeof(double)); /* held: nothing known moves it now */
    ht_inputs_at(s, t, u, slope);
    arg[0] = &t, arg[1] = ht_values(s, HT_STATE), arg[2] = u, arg[3] = ht_values(s, HT_PARAMETER);
    arg[4] = seed_xdot, arg[5] = seed_y, res[0] = &bar_t, res[1] = bar_x, res[2] = bar_u, res[3] = bar_p;
    if (ht_call(s, m->reverse, 6, arg, 4, res)) return ht_fail(s, HT_DISCARD, "the derivative failed");
    delay_answers(s, &bar_t, bar_u, bar_p, slope);
    for (k = 0; k < m->states; k++) bar_x[k] += seed_x[k];
    if (starting && pass_to_start(s, bar_x, bar_u, bar_p, bar_z, more)) return ht_fail(s, HT_DISCARD, "the derivative failed");
    from[HT_INPUT] = bar_u, from[HT_PARAMETER] = bar_p, from[HT_TIME] = &bar_t;
    from[starting ? HT_START : HT_STATE] = starting ? bar_z : bar_x;
    for (k = 0; k < knowns; k++) {
        ht_kind kind = ht_kind_of(m, known[k], &i);
        if (kind == HT_UNKNOWN || from[kind] == NULL)
            return ht_fail(s, HT_ERROR, "value reference %u is not a known of the present mode", known[k]);
        sensitivity[k] = from[kind][i];
    }
    return HT_OK;
}
