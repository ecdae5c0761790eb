/* Fixed-step Runge-Kutta 4 with events: dry friction sticks and breaks away at located instants, so that
 * within a step the right-hand side has one sign of friction only. */
#include <string.h>
#include "cehA.h"
#include "spool_valve.h"
#include "winch.h"
#include "lift_boom.h"
#include "test_cylinder.h"

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT
#endif
#define MOST_STATES 16
#define MOST_FIELDS 128

typedef struct { const Machine *m; const void *p; double u, slope, t_u; int direction, sliding; } Run;

static double input_at(const Run *r, double t) { return r->u + r->slope * (t - r->t_u); }

static void rk4(const Run *r, double t, const double *x, double h, double *next) {
    double k1[MOST_STATES], k2[MOST_STATES], k3[MOST_STATES], k4[MOST_STATES], z[MOST_STATES];
    int n = r->m->states, d = r->direction;
    double u0 = input_at(r, t), um = input_at(r, t + 0.5 * h), u1 = input_at(r, t + h);
    r->m->derivative(t, x, u0, r->p, d, k1);
    for (int i = 0; i < n; i++) z[i] = x[i] + 0.5 * h * k1[i];
    r->m->derivative(t + 0.5 * h, z, um, r->p, d, k2);
    for (int i = 0; i < n; i++) z[i] = x[i] + 0.5 * h * k2[i];
    r->m->derivative(t + 0.5 * h, z, um, r->p, d, k3);
    for (int i = 0; i < n; i++) z[i] = x[i] + h * k3[i];
    r->m->derivative(t + h, z, u1, r->p, d, k4);
    for (int i = 0; i < n; i++) next[i] = x[i] + h / 6 * (k1[i] + 2 * (k2[i] + k3[i]) + k4[i]);
}

/* Positive while the present mode holds: speed along the sliding direction, or the reserve of the sticking force. */
static double reserve(const Run *r, double t, const double *x) {
    if (r->direction) return r->direction * x[r->sliding];
    Contact c = r->m->contact(t, x, input_at(r, t), r->p);
    return c.hold - fabs(c.drive);
}

/* Bisect the step for the instant at which the present mode ends. */
static double locate(const Run *r, double t, const double *x, double h, double *at) {
    double low = 0, high = h, middle[MOST_STATES];
    for (int i = 0; i < 50 && high - low > 1e-13; i++) {
        double half = 0.5 * (low + high);
        rk4(r, t, x, half, middle);
        if (reserve(r, t + half, middle) < 0) high = half; else low = half;
    }
    rk4(r, t, x, high, at);
    return high;
}

/* At rest: stick, or slide the way the force points. */
static void choose_mode(Run *r, double t, double *x) {
    if (r->direction) x[r->sliding] = 0;
    Contact c = r->m->contact(t, x, input_at(r, t), r->p);
    r->direction = fabs(c.drive) > c.hold ? (int)sign_of(c.drive) : 0;
}

static void advance(Run *r, double t, double *x, double h) {
    double next[MOST_STATES], left = h;
    for (int events = 0; left > 0; events++) {
        rk4(r, t, x, left, next);
        if (r->sliding < 0 || reserve(r, t + left, next) >= 0) break;
        if (events >= 20) {                       /* chattering at one instant: rest for the remainder */
            x[r->sliding] = 0;
            r->direction = 0;
            rk4(r, t, x, left, next);
            break;
        }
        double used = locate(r, t, x, left, next);
        memcpy(x, next, sizeof(double) * r->m->states);
        t += used;
        left -= used;
        if (r->direction == 0) {
            Contact c = r->m->contact(t, x, input_at(r, t), r->p);
            r->direction = (int)sign_of(c.drive);
        } else {
            choose_mode(r, t, x);
        }
        if (left <= 0) return;
    }
    memcpy(x, next, sizeof(double) * r->m->states);
}

static void start_mode(Run *r, double t, double *x) {
    r->sliding = r->m->sliding_state(r->p);
    r->direction = 0;
    if (r->sliding < 0) return;
    if (x[r->sliding] != 0) r->direction = (int)sign_of(x[r->sliding]);
    else choose_mode(r, t, x);
}

typedef struct { const Machine *machine; size_t size; const char *names; } Entry;

static const Entry MACHINES[] = {
    {&cehA, sizeof(CehA), CEHA(RIG_NAME) ""},
    {&spool_valve, sizeof(Spool), SPOOL(RIG_NAME) ""},
    {&winch, sizeof(Winch), WINCH(RIG_NAME) ""},
    {&lift_boom, sizeof(LiftBoom), LIFT_BOOM(RIG_NAME) ""},
    {&test_cylinder, sizeof(TestCylinder), TEST_CYLINDER(RIG_NAME) ""},
};

static int fine(const Machine *m, const double *x, const double *p, const double *y) {
    for (int k = 0; k < m->outputs; k++)
        if (!isfinite(y[k])) return 0;
    return m->inside(x, p);
}

/* Run through breakpoints t[0..n-1]; on [t[i], t[i+1]) the input is u[i] + slope[i] (t - t[i]).
 * y: n rows of outputs. x: start state in, final state out.
 * Returns the first index at which an output is not finite or a volume is gone, or -1. */
EXPORT long rig_run(int machine, long n, const double *t, const double *u, const double *slope, const double *fields,
                    double step, double *x, double *y) {
    const Machine *m = MACHINES[machine].machine;
    double p[MOST_FIELDS];
    memcpy(p, fields, MACHINES[machine].size);
    Run r = {m, p, u[0], slope[0], t[0], 0, -1};
    start_mode(&r, t[0], x);
    m->output(x, p, y);
    for (long i = 0; i + 1 < n; i++) {
        double dt = t[i + 1] - t[i];
        long steps = (long)ceil(dt / step - 1e-9);
        if (steps < 1) steps = 1;
        ((Common *)p)->now = t[i] + 0.5 * dt;
        r.u = u[i]; r.slope = slope[i]; r.t_u = t[i];
        for (long j = 0; j < steps; j++) {
            double now = t[i] + dt * j / steps;
            if (m->settle) m->settle(x, input_at(&r, now), p);
            advance(&r, now, x, dt / steps);
        }
        m->output(x, p, y + (i + 1) * m->outputs);
        if (!fine(m, x, p, y + (i + 1) * m->outputs)) return i + 1;
    }
    return -1;
}

EXPORT const char *rig_names(int machine) { return MACHINES[machine].names; }
