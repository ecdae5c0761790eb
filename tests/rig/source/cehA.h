/* Compact electrohydraulic actuator lifting an arm: motor, pump, differential cylinder, link, gravity. */
#include "common.h"

#define CEHA(X)                                                                                            \
    COMMON(X)                                                                                              \
    X(gain) X(time_constant) X(displacement) X(area_a) X(area_b) X(dead_a) X(dead_b) X(beta)                 \
    X(kinetic) X(static_force) X(viscous) X(stribeck) X(smoothing) X(exact)                                  \
    X(extra_mass) X(arm_mass) X(length) X(pin) X(base) X(retracted)                                          \
    X(droop) X(slip) X(slip_speed) X(lost_share) X(lost_speed) X(tilt) X(ripple_flow) X(pistons)             \
    X(cogging) X(poles)
typedef struct { CEHA(RIG_FIELD) } CehA;

enum { C_W, C_PA, C_PB, C_THETA, C_OMEGA, C_XR, C_VR, C_Z, C_U, C_PHI, C_OA, C_OB, C_STATES };

typedef struct { double s, lever, x, v; } Link;

static Link link_of(const CehA *p, double theta, double omega) {
    Link k;
    k.s = sqrt(p->pin * p->pin + p->base * p->base + 2 * p->pin * p->base * sin(theta));
    k.lever = p->pin * p->base * cos(theta) / k.s;
    k.x = k.s - p->retracted;
    k.v = k.lever * omega;
    return k;
}

static int cehA_loose(const CehA *p) { return p->coupling_stiffness > 0; }

static double cehA_rod(const CehA *p, const double *x) {
    return cehA_loose(p) ? x[C_XR] : link_of(p, x[C_THETA], 0).x;
}

typedef struct { double Va, Vb, pa, pb; } Chambers;

static Chambers cehA_chambers(const CehA *p, const double *x) {
    const Common *c = (const Common *)p;
    double xr = cehA_rod(p, x);
    Chambers k = {p->dead_a + p->area_a * xr, p->dead_b - p->area_b * xr, x[C_PA], x[C_PB]};
    if (c->separates > 0) {
        k.pa = separated_pressure(c, x[C_OA], k.Va, p->beta);
        k.pb = separated_pressure(c, x[C_OB], k.Vb, p->beta);
    }
    return k;
}

/* The base friction of the paper (Eq. 8): smoothed sign, or only the viscous part when the dry part is exact. */
static double cehA_smooth_friction(const CehA *p, double t, double v) {
    double ratio = v / p->stribeck, dry = 0;
    if (!(p->exact > 0))
        dry = (p->kinetic + (p->static_force - p->kinetic) * exp(-ratio * ratio)) * tanh(v / p->smoothing);
    return dry + warmed((const Common *)p, p->viscous, t) * v;
}

static double cehA_dry(const CehA *p, double speed, double x, double pa, double pb, int direction) {
    double force = dry_friction((const Common *)p, speed, x, pa, pb, direction), ratio = speed / p->stribeck;
    if (p->exact > 0) force += p->kinetic + (p->static_force - p->kinetic) * exp(-ratio * ratio);
    return force;
}

static double cehA_payload(const CehA *p) { return p->extra_mass + payload_change((const Common *)p); }

/* Everything that pushes the sliding body except exact dry friction [N at the rod]. */
static double cehA_drive(const CehA *p, double t, const double *x, double *dz, double *pin_force) {
    const Common *c = (const Common *)p;
    Link k = link_of(p, x[C_THETA], x[C_OMEGA]);
    int loose = cehA_loose(p);
    double xr = loose ? x[C_XR] : k.x, vr = loose ? x[C_VR] : k.v;
    Chambers o = cehA_chambers(p, x);
    double F = o.pa * p->area_a - o.pb * p->area_b;
    double force = F - cehA_smooth_friction(p, t, vr) - bristles(c, vr, x[C_Z], dz) + stop_force(c, xr, vr);
    if (loose) {
        *pin_force = coupling_force(c, xr - k.x, vr - k.v);
        return force - *pin_force;
    }
    *pin_force = 0;
    double m = cehA_payload(p) + 0.5 * p->arm_mass;
    return force - external_force(c) - m * 9.80665 * p->length * cos(x[C_THETA] + p->tilt) / k.lever;
}

static void cehA_motion(const CehA *p, double t, const double *x, int direction, double dry, double *dx) {
    Link k = link_of(p, x[C_THETA], x[C_OMEGA]);
    double pin, m1 = cehA_payload(p), L = p->length;
    double J = (m1 + p->arm_mass / 3) * L * L;
    if (cehA_loose(p)) J -= p->rod_mass * k.lever * k.lever; /* as stated for all that moves: the rod is part of it */
    double drive = cehA_drive(p, t, x, &dx[C_Z], &pin) - direction * dry;
    dx[C_THETA] = x[C_OMEGA];
    if (!cehA_loose(p)) {
        dx[C_OMEGA] = direction == 0 && dry > 0 ? 0 : k.lever * drive / J;
        dx[C_XR] = dx[C_VR] = 0;
        return;
    }
    double load = (m1 + 0.5 * p->arm_mass) * 9.80665 * L * cos(x[C_THETA] + p->tilt);
    dx[C_OMEGA] = (k.lever * (pin - external_force((const Common *)p)) - load) / J;
    dx[C_XR] = x[C_VR];
    dx[C_VR] = direction == 0 && dry > 0 ? 0 : drive / p->rod_mass;
}

static double cehA_flow(const CehA *p, const double *x) {
    double w = x[C_W], speed = fabs(w), q = p->displacement * w;
    if (p->lost_share > 0) q *= 1 - p->lost_share * exp(-speed / p->lost_speed);
    if (p->ripple_flow > 0) q *= 1 + p->ripple_flow * cos(p->pistons * x[C_PHI]);
    return q;
}

static void cehA_derivative(double t, const double *x, double u, const void *pv, int direction, double *dx) {
    const CehA *p = pv;
    const Common *c = pv;
    Link k = link_of(p, x[C_THETA], x[C_OMEGA]);
    double xr = cehA_loose(p) ? x[C_XR] : k.x, vr = cehA_loose(p) ? x[C_VR] : k.v;
    Chambers o = cehA_chambers(p, x);
    double pa = o.pa, pb = o.pb, ratio = p->area_b / p->area_a;
    double command = c->command_lag > 0 ? x[C_U] : u;
    dx[C_U] = c->command_lag > 0 ? (u - x[C_U]) / c->command_lag : 0;
    double torque = p->displacement * (pa - ratio * pb);
    double target = p->gain * (1 + c->drift * t) * command - p->droop * torque;
    if (p->cogging > 0) target -= p->cogging * sin(p->poles * x[C_PHI]);
    dx[C_W] = (target - x[C_W]) / p->time_constant;
    dx[C_PHI] = x[C_W];
    double q = cehA_flow(p, x);
    double slip = p->slip > 0 ? p->slip * (pa - pb) / (1 + fabs(x[C_W]) / p->slip_speed) : 0;
    double across = internal_leak(c, pa, pb) + slip;
    double qa = q - across - loss(c, c->leak_a, pa), qb = across - ratio * q - loss(c, c->leak_b, pb);
    dx[C_PA] = (qa - p->area_a * vr) / capacity(c, o.Va, pa, p->beta, c->hose_a);
    dx[C_PB] = (qb + p->area_b * vr) / capacity(c, o.Vb, pb, p->beta, c->hose_b);
    dx[C_OA] = c->separates > 0 ? oil_gained(qa, x[C_OA], o.Va) : 0;
    dx[C_OB] = c->separates > 0 ? oil_gained(qb, x[C_OB], o.Vb) : 0;
    cehA_motion(p, t, x, direction, cehA_dry(p, fabs(vr), xr, pa, pb, direction), dx);
}

static Contact cehA_contact(double t, const double *x, double u, const void *pv) {
    const CehA *p = pv;
    double dz, pin;
    Chambers o = cehA_chambers(p, x);
    (void)u;
    Contact contact = {cehA_drive(p, t, x, &dz, &pin), 0};
    contact.hold = cehA_dry(p, 0, cehA_rod(p, x), o.pa, o.pb, (int)sign_of(contact.drive));
    return contact;
}

static int cehA_sliding_state(const void *pv) {
    const CehA *p = pv;
    if (!is_dry(pv) && !(p->exact > 0)) return -1;
    return cehA_loose(p) ? C_VR : C_OMEGA;
}

static int cehA_inside(const double *x, const void *pv) {
    const CehA *p = pv;
    Chambers o = cehA_chambers(p, x);
    return fabs(x[C_THETA]) < 1.5 && o.Va > 0 && o.Vb > 0;
}

static void cehA_output(const double *x, const void *pv, double *y) {
    const CehA *p = pv;
    y[0] = x[C_THETA];
    y[1] = x[C_W];
    Chambers o = cehA_chambers(p, x);
    y[2] = cehA_rod(p, x);
    y[3] = o.pa;
    y[4] = o.pb;
    y[5] = o.pa * p->area_a - o.pb * p->area_b;
}

static const Machine cehA = {
    C_STATES, 6, cehA_derivative, cehA_contact, cehA_sliding_state, cehA_inside, cehA_output, NULL};
