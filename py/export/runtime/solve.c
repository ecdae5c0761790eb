#include <math.h>
#include <string.h>

#include "internal.h"

#define MOST_SUBSTEPS 1e8
#define MOST_HALVINGS 12 /* of an adaptive step */
#define MOST_PARTS 1e6 /* tried in one refined step: a state that chatters has no solution to wait for */

/* ---- the generated functions ---- */

int ht_call(ht_instance *s, ht_function f, size_t args, const double *const *arg, size_t ress, double *const *res) {
    size_t k;
    for (k = 0; k < args; k++) s->arg[k] = arg[k];
    for (k = 0; k < ress; k++) s->res[k] = res[k];
    return f(s->arg, s->res, s->iw, s->w, 0);
}

static int derivative(ht_instance *s, double t, const double *x, const double *u, double *xdot) {
    const double *arg[4];
    arg[0] = &t, arg[1] = x, arg[2] = u, arg[3] = ht_values(s, HT_PARAMETER);
    return ht_call(s, s->model->derivative, 4, arg, 1, &xdot);
}

/* Classical Runge-Kutta of order 4 over h with the mean of the inputs, from x to next. scratch: 5 states. */
static int runge_kutta(ht_instance *s, double t, double h, const double *x, double *next, double *scratch, double *rough) {
    size_t n = s->model->states, i;
    double *k1 = scratch, *k2 = k1 + n, *k3 = k2 + n, *k4 = k3 + n, *z = k4 + n, *u = s->scratch;
    ht_inputs_mean(s, t, t + h, u);
    if (derivative(s, t, x, u, k1)) return 1;
    for (i = 0; i < n; i++) z[i] = x[i] + 0.5 * h * k1[i];
    if (derivative(s, t + 0.5 * h, z, u, k2)) return 1;
    for (i = 0; i < n; i++) z[i] = x[i] + 0.5 * h * k2[i];
    if (derivative(s, t + 0.5 * h, z, u, k3)) return 1;
    for (i = 0; i < n; i++) z[i] = x[i] + h * k3[i];
    if (derivative(s, t + h, z, u, k4)) return 1;
    for (*rough = 0.0, i = 0; i < n; i++) {
        double unit = s->model->nominals[i] + fabs(x[i]);
        double one = h / 6.0 * (k1[i] - k2[i] - k3[i] + k4[i]) / unit, other = h / 3.0 * (k3[i] - k2[i]) / unit;
        *rough += one * one + other * other;
    }
    for (i = 0; i < n; i++) next[i] = x[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
    return 0;
}

static int explicit_step(ht_instance *s, double t, double h, double *x, double *scratch) {
    double rough;
    return runge_kutta(s, t, h, x, x, scratch, &rough);
}

static int agree(const ht_model *m, const double *whole, const double *halves) {
    double sum = 0.0, tolerance = m->refinement.tolerance;
    size_t i;
    for (i = 0; i < m->states; i++) {
        double apart = (whole[i] - halves[i]) / (m->nominals[i] + fabs(halves[i]));
        sum += apart * apart;
    }
    return sum <= tolerance * tolerance; /* not so for nan */
}

/* The same; where its slopes say that a contact or another kink lies inside, in parts of h / 2^level, each as long as it
   agrees with its two halves. scratch: 8 states. */
static int refined_step(ht_instance *s, double t, double h, double *x, double *scratch) {
    const ht_model *m = s->model;
    size_t n = m->states;
    double *whole = scratch, *middle = whole + n, *halves = middle + n, *slopes = halves + n, rough;
    double all = ldexp(1.0, m->refinement.deepest), done = 0.0, part = all, tried;
    if (runge_kutta(s, t, h, x, whole, slopes, &rough)) return 1;
    if (rough < m->refinement.smooth * m->refinement.smooth) {
        memcpy(x, whole, n * sizeof(double));
        return 0;
    }
    for (tried = 0.0; done < all; tried += 1.0) {
        double half = 0.5 * h * (part / all), from = t + h * (done / all);
        if (tried > MOST_PARTS || runge_kutta(s, from, 2.0 * half, x, whole, slopes, &rough) ||
            runge_kutta(s, from, half, x, middle, slopes, &rough) ||
            runge_kutta(s, from + half, half, middle, halves, slopes, &rough))
            return 1;
        if (part > 1.0 && !agree(m, whole, halves)) {
            part *= 0.5;
            continue;
        }
        memcpy(x, halves, n * sizeof(double));
        if (!ht_finite(x, n)) return 0; /* the caller says which state */
        done += part;
        if (part < all && fmod(done, 2.0 * part) == 0.0) part *= 2.0;
    }
    return 0;
}

/* A step of the generated Rosenbrock method, in as many steps of its own as it takes: one where it is fixed. */
static int implicit_step(ht_instance *s, double t, double h, double *x, double *scratch) {
    const double *arg[5];
    double *res[1], *u = s->scratch;
    ht_inputs_mean(s, t, t + h, u);
    arg[0] = &t, arg[1] = &h, arg[2] = x, arg[3] = u, arg[4] = ht_values(s, HT_PARAMETER);
    res[0] = scratch;
    if (ht_call(s, s->model->advance, 5, arg, 1, res)) return 1;
    memcpy(x, scratch, s->model->states * sizeof(double));
    return 0;
}

/* The same; in halves where the method gives up, whose steps would be too many. */
static int adaptive_step(ht_instance *s, double t, double h, double *x, double *scratch) {
    size_t n = s->model->states;
    double all = ldexp(1.0, MOST_HALVINGS), done = 0.0, part = all, *before = scratch + n;
    while (done < all) {
        memcpy(before, x, n * sizeof(double));
        if (!implicit_step(s, t + h * (done / all), h * (part / all), x, scratch) && ht_finite(x, n)) {
            done += part;
            continue;
        }
        memcpy(x, before, n * sizeof(double));
        if ((part *= 0.5) < 1.0) return 1;
    }
    return 0;
}

/* An internal step from t over h, x in place; not 0: it failed. */
typedef int internal_step(ht_instance *s, double t, double h, double *x, double *scratch);

/* One from `from` to `to`, h apart, in pieces: what follows from the mean of two values is not the mean of what follows from
   each, so that a piece ends where a delayed input jumps. */
static int step_in_pieces(ht_instance *s, internal_step *step, double from, double to, double h, double *x, double *scratch) {
    double t, until;
    for (t = from; t < to; t = until) {
        until = ht_inputs_jump(s, t, to);
        if (step(s, t, t > from || until < to ? until - t : h, x, scratch)) return 1;
    }
    return 0;
}

ht_status ht_integrate(ht_instance *s, double t, double size, double *end) {
    const ht_model *m = s->model;
    internal_step *step = m->method == HT_EXPLICIT ? explicit_step : m->method == HT_REFINED ? refined_step : m->method == HT_IMPLICIT ? implicit_step : adaptive_step;
    double *x = ht_values(s, HT_STATE), *work = s->scratch + m->inputs;
    double count = ceil(size / m->step - 1e-6), from = t, to, h, k;
    if (m->method == HT_ADAPTIVE && ht_inputs_steady(s) && !s->watcher) count = 1.0;
    if (count < 1.0) count = 1.0;
    if (count > MOST_SUBSTEPS)
        return ht_fail(s, HT_DISCARD, "a step of %g s needs %g internal steps of %g s", size, count, m->step);
    for (k = 1.0; k <= count && from < *end; k += 1.0, from = to) {
        h = size / count;
        to = k < count ? t + k * h : t + size;
        if (to > *end) to = *end, h = to - from; /* a watcher wants to return inside this internal step */
        if (step_in_pieces(s, step, from, to, h, x, work))
            return ht_fail(s, HT_DISCARD, "the solver did not converge between t = %.9g s and %.9g s", from, to);
        if (!ht_finite(x, m->states)) {
            size_t i = 0;
            while (i + 1 < m->states && ht_finite(x + i, 1)) i++;
            return ht_fail(s, HT_DISCARD, "state '%s' is not finite at t = %.9g s", m->labels[ht_place_of(m, HT_STATE) + i], to);
        }
        *end = ht_pause(s, to, *end);
    }
    return HT_OK;
}

/* ---- sampled blocks ---- */

double ht_sample_time(const ht_instance *s) { return ht_book(s)[START_TIME] + ht_book(s)[SAMPLE] * s->model->step; }

/* Note when the block leaves the data it was trained with, once each time. */
static void watch_domain(ht_instance *s, double t) {
    int outside = s->model->inside >= 0 && ht_values(s, HT_OUTPUT)[s->model->inside] < 0.5;
    if (outside && ht_book(s)[OUTSIDE] == 0.0) {
        s->left_domain = 1;
        s->left_at = t;
    }
    ht_book(s)[OUTSIDE] = outside;
}

/* Outputs of the sample due at time t; with `commit` the block moves on to its next sample. */
static ht_status take_sample(ht_instance *s, double t, int commit) {
    const ht_model *m = s->model;
    double *u = s->scratch, *next = u + m->inputs;
    const double *arg[3];
    double *res[2];
    ht_inputs_at(s, t, u, NULL);
    arg[0] = ht_values(s, HT_STATE), arg[1] = u, arg[2] = ht_values(s, HT_PARAMETER);
    res[0] = commit ? next : NULL, res[1] = ht_values(s, HT_OUTPUT);
    if (ht_call(s, m->advance, 3, arg, 2, res) || !ht_finite(res[1], m->outputs) || (commit && !ht_finite(next, m->states)))
        return ht_fail(s, HT_DISCARD, "the sample at t = %.9g s is not finite", t);
    if (commit) {
        memcpy(ht_values(s, HT_STATE), next, m->states * sizeof(double));
        ht_book(s)[SAMPLE] += 1.0;
        watch_domain(s, t);
    }
    return HT_OK;
}

ht_status ht_sample_through(ht_instance *s, double t, double size, double *end) {
    double slack = HT_SLACK * s->model->step, due;
    if (size / s->model->step > MOST_SUBSTEPS) return ht_fail(s, HT_DISCARD, "a step of %g s is too long", size);
    for (due = ht_sample_time(s); due < *end - slack; due = ht_sample_time(s)) {
        if (due > t + slack) *end = ht_pause(s, due, *end);
        if (due < *end - slack && take_sample(s, due > t ? due : t, 1) != HT_OK) return HT_DISCARD;
    }
    if (ht_time(s) < *end) *end = ht_pause(s, *end, *end);
    return HT_OK;
}

/* ---- what follows from the present state ---- */

ht_status ht_start_states(ht_instance *s) {
    const ht_model *m = s->model;
    const double *arg[3];
    double *res[1];
    size_t i;
    arg[0] = ht_values(s, HT_INPUT), arg[1] = ht_values(s, HT_PARAMETER), arg[2] = ht_starts(s);
    res[0] = ht_values(s, HT_STATE);
    if (ht_call(s, m->start, 3, arg, 1, res)) return ht_fail(s, HT_ERROR, "the initial states cannot be computed");
    for (i = 0; i < m->states; i++)
        if (!ht_finite(res[0] + i, 1))
            return ht_fail(s, HT_ERROR, "the initial value of '%s' is not finite", m->labels[ht_place_of(m, HT_STATE) + i]);
    return HT_OK;
}

static ht_status present_outputs(ht_instance *s) {
    const ht_model *m = s->model;
    double t = ht_time(s), *u = s->scratch;
    int exchanged = s->interface == HT_MODEL_EXCHANGE, failed;
    const double *arg[4];
    double *res[2];
    if (m->method == HT_SAMPLED)
        return ht_sample_time(s) < t + HT_SLACK * m->step ? take_sample(s, t, 0) : HT_OK;
    ht_inputs_at(s, t, u, NULL);
    arg[0] = &t, arg[1] = ht_values(s, HT_STATE), arg[2] = u, arg[3] = ht_values(s, HT_PARAMETER);
    res[0] = ht_values(s, HT_DERIVATIVE), res[1] = ht_values(s, HT_OUTPUT);
    failed = exchanged ? ht_call(s, m->output, 4, arg, 2, res) : ht_call(s, m->present, 4, arg, 1, res + 1);
    ht_book(s)[RATES_STALE] = exchanged ? 0.0 : 1.0;
    if (failed || !ht_finite(res[1], m->outputs))
        return ht_fail(s, HT_DISCARD, "an output is not finite at t = %.9g s", t);
    return HT_OK;
}

ht_status ht_refresh_rates(ht_instance *s) {
    double t = ht_time(s), *u = s->scratch;
    const double *arg[4];
    double *res[1];
    if (ht_book(s)[RATES_STALE] == 0.0) return HT_OK;
    ht_inputs_at(s, t, u, NULL);
    arg[0] = &t, arg[1] = ht_values(s, HT_STATE), arg[2] = u, arg[3] = ht_values(s, HT_PARAMETER);
    res[0] = ht_values(s, HT_DERIVATIVE);
    if (ht_call(s, s->model->derivative, 4, arg, 1, res))
        return ht_fail(s, HT_DISCARD, "the derivatives cannot be computed at t = %.9g s", t);
    ht_book(s)[RATES_STALE] = 0.0;
    return HT_OK;
}

ht_status ht_refresh(ht_instance *s) {
    ht_status status = HT_OK;
    if (ht_book(s)[STALE] == 0.0) return HT_OK;
    if (ht_phase_of(s) == HT_INITIALISING) status = ht_start_states(s);
    if (status == HT_OK) status = present_outputs(s);
    if (status == HT_OK) ht_book(s)[STALE] = 0.0;
    return status;
}

