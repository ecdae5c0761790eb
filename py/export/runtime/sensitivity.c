#include <string.h>

#include "internal.h"

/* ---- directional derivatives ---- */

int ht_has_derivatives(ht_instance *s) {
    ht_phase phase = ht_phase_of(s);
    if (phase != HT_INSTANTIATED && phase != HT_TERMINATED && phase != HT_BETWEEN) return 1;
    ht_fail(s, HT_ERROR, "derivatives are available from initialization mode on, at communication points");
    return 0;
}

/* Spread the seeds over (dx, du, dp, dz); which kinds may be known depends on the phase. */
static ht_status read_seeds(ht_instance *s, const unsigned *known, size_t n, const double *seed, double *const to[]) {
    size_t k, i = 0;
    int starting = ht_phase_of(s) == HT_INITIALISING;
    for (k = 0; k < n; k++) {
        ht_kind kind = ht_kind_of(s->model, known[k], &i);
        if (kind == HT_UNKNOWN || to[kind] == NULL || (kind == HT_STATE && starting) || (kind == HT_START && !starting))
            return ht_fail(s, HT_ERROR, "value reference %u is not a known of the present mode", known[k]);
        to[kind][i] = seed[k];
    }
    return HT_OK;
}

/* An input that is delayed answers to its dead time, not to its present value. */
static void delay_seeds(ht_instance *s, double dt, double *du, const double *dp, double *u, double *slope) {
    size_t k;
    ht_inputs_at(s, ht_time(s), u, slope);
    for (k = 0; k < s->model->inputs; k++)
        if (s->model->dead_time[k] >= 0 && ht_phase_of(s) != HT_INITIALISING) {
            int delayed = ht_dead_time(s, k) > 0.0;
            du[k] = (delayed ? 0.0 : du[k]) + slope[k] * (dt - dp[s->model->dead_time[k]]);
        }
}

ht_status ht_directional(ht_instance *s, const unsigned *unknown, size_t unknowns, const unsigned *known, size_t knowns,
                         const double *seed, double *sensitivity) {
    const ht_model *m = s->model;
    double *dx = s->scratch, *du = dx + m->states, *dp = du + m->inputs, *dz = dp + m->parameters;
    double *dxdot = dz + m->starts, *dy = dxdot + m->derivatives, *u = dy + m->outputs, *slope = u + m->inputs;
    double *to[HT_UNKNOWN] = {NULL}, *from[HT_UNKNOWN] = {NULL}, t = ht_time(s), dt = 0.0;
    const double *arg[8];
    double *res[2];
    size_t k, i = 0;
    ht_status status;
    if (!ht_has_derivatives(s)) return HT_ERROR;
    status = ht_refresh(s);
    if (status != HT_OK) return status;
    memset(dx, 0, ht_scratch_doubles(m) * sizeof(double));
    to[HT_TIME] = &dt, to[HT_INPUT] = du, to[HT_PARAMETER] = dp, to[HT_START] = dz, to[HT_STATE] = dx;
    from[HT_OUTPUT] = dy, from[HT_STATE] = dx, from[HT_DERIVATIVE] = dxdot;
    if (read_seeds(s, known, knowns, seed, to) != HT_OK) return HT_ERROR;
    if (ht_phase_of(s) == HT_INITIALISING) {
        arg[0] = ht_values(s, HT_INPUT), arg[1] = ht_values(s, HT_PARAMETER), arg[2] = ht_starts(s);
        arg[3] = du, arg[4] = dp, arg[5] = dz, res[0] = dx;
        if (ht_call(s, m->start_forward, 6, arg, 1, res)) return ht_fail(s, HT_DISCARD, "the derivative failed");
    }
    delay_seeds(s, dt, du, dp, u, slope);
    arg[0] = &t, arg[1] = ht_values(s, HT_STATE), arg[2] = u, arg[3] = ht_values(s, HT_PARAMETER);
    arg[4] = &dt, arg[5] = dx, arg[6] = du, arg[7] = dp, res[0] = dxdot, res[1] = dy;
    if (ht_call(s, m->forward, 8, arg, 2, res)) return ht_fail(s, HT_DISCARD, "the derivative failed");
    if (m->method == HT_SAMPLED && ht_sample_time(s) > t + HT_SLACK * m->step)
        memset(dy, 0, m->outputs * sizeof(double)); /* held: nothing known moves it now */
    for (k = 0; k < unknowns; k++) {
        ht_kind kind = ht_kind_of(m, unknown[k], &i);
        if (kind == HT_UNKNOWN || from[kind] == NULL)
            return ht_fail(s, HT_ERROR, "value reference %u has no derivative", unknown[k]);
        sensitivity[k] = from[kind][i];
    }
    return HT_OK;
}
