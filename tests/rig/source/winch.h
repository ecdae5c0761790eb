/* Winch: motor and pump, two hoses, a hydraulic motor whose shaft winds a rope, a load that hangs on it. The return
 * hose is fed from a boost supply. */
#include "common.h"

#define WINCH(X)                                                                                           \
    COMMON(X)                                                                                              \
    X(gain) X(time_constant) X(displacement) X(motor_displacement) X(volume_a) X(volume_b) X(beta_a) X(beta_b) \
    X(boost) X(boost_conductance) X(radius) X(inertia) X(mass) X(viscous) X(droop)
typedef struct { WINCH(RIG_FIELD) } Winch;

enum { W_W, W_PA, W_PB, W_S, W_V, W_STATES };

static double winch_mass(const Winch *p) { return p->mass + payload_change((const Common *)p); }

/* Everything that pulls the rope upwards except dry friction [N]. */
static double winch_drive(const Winch *p, double t, const double *x) {
    const Common *c = (const Common *)p;
    double pull = p->motor_displacement * (x[W_PA] - x[W_PB]) / p->radius;
    return pull - winch_mass(p) * 9.80665 - warmed(c, p->viscous, t) * x[W_V] - external_force(c);
}

static void winch_derivative(double t, const double *x, double u, const void *pv, int direction, double *dx) {
    const Winch *p = pv;
    const Common *c = pv;
    double pa = x[W_PA], pb = x[W_PB];
    double torque = p->displacement * (pa - pb);
    dx[W_W] = (p->gain * (1 + c->drift * t) * u - p->droop * torque - x[W_W]) / p->time_constant;
    double pumped = p->displacement * x[W_W], swallowed = p->motor_displacement * x[W_V] / p->radius;
    double across = internal_leak(c, pa, pb);
    double qa = pumped - swallowed - across - loss(c, c->leak_a, pa);
    double fed = p->boost_conductance * (p->boost - pb);
    double qb = swallowed - pumped + across + fed - loss(c, c->leak_b, pb);
    dx[W_PA] = qa / capacity(c, p->volume_a, pa, p->beta_a, c->hose_a);
    dx[W_PB] = qb / capacity(c, p->volume_b, pb, p->beta_b, c->hose_b);
    double dry = dry_friction(c, fabs(x[W_V]), x[W_S], pa, pb, direction);
    double moved = winch_mass(p) + p->inertia / (p->radius * p->radius);
    dx[W_S] = x[W_V];
    dx[W_V] = direction == 0 && dry > 0 ? 0 : (winch_drive(p, t, x) - direction * dry) / moved;
}

static Contact winch_contact(double t, const double *x, double u, const void *pv) {
    (void)u;
    Contact contact = {winch_drive(pv, t, x), 0};
    contact.hold = dry_friction(pv, 0, x[W_S], x[W_PA], x[W_PB], (int)sign_of(contact.drive));
    return contact;
}

static int winch_sliding_state(const void *pv) { return is_dry(pv) ? W_V : -1; }

static int winch_inside(const double *x, const void *pv) {
    (void)pv;
    return fabs(x[W_S]) < 100;
}

static void winch_output(const double *x, const void *pv, double *y) {
    (void)pv;
    y[0] = x[W_S];
    y[1] = x[W_W];
    y[2] = x[W_PA];
    y[3] = x[W_PB];
}

static const Machine winch = {
    W_STATES, 4, winch_derivative, winch_contact, winch_sliding_state, winch_inside, winch_output, NULL};
