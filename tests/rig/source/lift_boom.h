/* Boom on a joint, raised by a cylinder behind a spool valve: a linkage, with gravity that changes along the stroke. */
#include "edges.h"

#define LIFT_BOOM(X)                                                                                       \
    COMMON(X) EDGES(X)                                                                                     \
    X(area_a) X(area_b) X(dead_a) X(dead_b) X(stroke) X(beta) X(viscous)                                     \
    X(payload) X(boom_mass) X(length) X(pin) X(foot) X(retracted)
typedef struct { LIFT_BOOM(RIG_FIELD) } LiftBoom;

enum { L_S, L_SD, L_PA, L_PB, L_THETA, L_OMEGA, L_PS, L_STATES };

/* Triangle of joint, foot and pin: the foot lies straight below the joint. */
typedef struct { double stroke, lever, Va, Vb; } Triangle;

static Triangle triangle_of(const LiftBoom *p, double theta) {
    double square = p->pin * p->pin + p->foot * p->foot - 2 * p->pin * p->foot * cos(theta + M_PI / 2);
    double side = sqrt(square);
    Triangle k = {side - p->retracted, p->pin * p->foot * sin(theta + M_PI / 2) / side, 0, 0};
    k.Va = p->dead_a + p->area_a * k.stroke;
    k.Vb = p->dead_b + p->area_b * (p->stroke - k.stroke);
    return k;
}

/* Torque on the boom except that of dry friction, over the lever: a force at the rod [N]. */
static double lift_boom_drive(const LiftBoom *p, double t, const double *x) {
    const Common *c = (const Common *)p;
    Triangle k = triangle_of(p, x[L_THETA]);
    double weight = (p->payload + payload_change(c)) * p->length + p->boom_mass * p->length / 2;
    double rod = x[L_PA] * p->area_a - x[L_PB] * p->area_b - warmed(c, p->viscous, t) * k.lever * x[L_OMEGA];
    rod += stop_force(c, k.stroke, k.lever * x[L_OMEGA]) - external_force(c);
    return rod - weight * 9.80665 * cos(x[L_THETA]) / k.lever;
}

static void lift_boom_derivative(double t, const double *x, double u, const void *pv, int direction, double *dx) {
    const LiftBoom *p = pv;
    const Common *c = pv;
    Triangle k = triangle_of(p, x[L_THETA]);
    double pa = x[L_PA], pb = x[L_PB], v = k.lever * x[L_OMEGA];
    dx[L_S] = x[L_SD];
    dx[L_SD] = p->frequency * (p->frequency * (u - x[L_S]) - 2 * p->damping * x[L_SD]);
    Valve valve = VALVE_OF(p, x[L_PS]);
    valve.flow_gain *= 1 + c->drift * t;
    Flows q = four_edges(&valve, x[L_S], pa, pb);
    dx[L_PS] = supply_rate(p->supply, p->supply_resistance, p->supply_volume, p->beta, x[L_PS], q.supply);
    double across = internal_leak(c, pa, pb);
    dx[L_PA] = (q.a - across - loss(c, c->leak_a, pa) - p->area_a * v) / capacity(c, k.Va, pa, p->beta, c->hose_a);
    dx[L_PB] = (q.b + across - loss(c, c->leak_b, pb) + p->area_b * v) / capacity(c, k.Vb, pb, p->beta, c->hose_b);
    double dry = dry_friction(c, fabs(v), k.stroke, pa, pb, direction), L2 = p->length * p->length;
    double inertia = (p->payload + payload_change(c)) * L2 + p->boom_mass * L2 / 3;
    dx[L_THETA] = x[L_OMEGA];
    dx[L_OMEGA] = direction == 0 && dry > 0 ? 0 : k.lever * (lift_boom_drive(p, t, x) - direction * dry) / inertia;
}

static Contact lift_boom_contact(double t, const double *x, double u, const void *pv) {
    const LiftBoom *p = pv;
    (void)u;
    Contact contact = {lift_boom_drive(p, t, x), 0};
    double stroke = triangle_of(p, x[L_THETA]).stroke;
    contact.hold = dry_friction(pv, 0, stroke, x[L_PA], x[L_PB], (int)sign_of(contact.drive));
    return contact;
}

static int lift_boom_sliding_state(const void *pv) { return is_dry(pv) ? L_OMEGA : -1; }

static int lift_boom_inside(const double *x, const void *pv) {
    Triangle k = triangle_of(pv, x[L_THETA]);
    return fabs(x[L_THETA]) < 1.5 && k.Va > 0 && k.Vb > 0;
}

static void lift_boom_output(const double *x, const void *pv, double *y) {
    y[0] = x[L_THETA];
    y[1] = x[L_S];
    y[2] = x[L_PA];
    y[3] = x[L_PB];
    y[4] = triangle_of(pv, x[L_THETA]).stroke;
}

static const Machine lift_boom = {
    L_STATES, 5, lift_boom_derivative, lift_boom_contact, lift_boom_sliding_state, lift_boom_inside, lift_boom_output,
    NULL};
