/* Test cylinder under a position controller: spool valve, two hoses that give and resist, cylinder, sliding mass. The
 * input is the wanted position. */
#include "edges.h"

#define TEST_CYLINDER(X)                                                                                   \
    COMMON(X) EDGES(X)                                                                                     \
    X(control_gain) X(play) X(hose_volume_a) X(hose_volume_b) X(hose_beta_a) X(hose_beta_b)                  \
    X(hose_conductance_a) X(hose_conductance_b) X(area_a) X(area_b) X(dead_a) X(dead_b) X(stroke)      \
    X(beta) X(viscous) X(mass) X(load)
typedef struct { TEST_CYLINDER(RIG_FIELD) } TestCylinder;

enum { T_S, T_SD, T_HA, T_HB, T_PA, T_PB, T_X, T_V, T_PLAY, T_PS, T_STATES };

static double wanted_spool(const TestCylinder *p, const double *x, double u) { return p->control_gain * (u - x[T_X]); }

static double test_cylinder_drive(const TestCylinder *p, double t, const double *x) {
    const Common *c = (const Common *)p;
    double rod = x[T_PA] * p->area_a - x[T_PB] * p->area_b - warmed(c, p->viscous, t) * x[T_V];
    return rod + stop_force(c, x[T_X], x[T_V]) - p->load - external_force(c);
}

static void test_cylinder_derivative(double t, const double *x, double u, const void *pv, int direction, double *dx) {
    const TestCylinder *p = pv;
    const Common *c = pv;
    double pa = x[T_PA], pb = x[T_PB], v = x[T_V];
    double target = p->play > 0 ? x[T_PLAY] : wanted_spool(p, x, u);
    dx[T_S] = x[T_SD];
    dx[T_SD] = p->frequency * (p->frequency * (target - x[T_S]) - 2 * p->damping * x[T_SD]);
    dx[T_PLAY] = 0;
    Valve valve = VALVE_OF(p, x[T_PS]);
    Flows q = four_edges(&valve, x[T_S], x[T_HA], x[T_HB]);
    dx[T_PS] = supply_rate(p->supply, p->supply_resistance, p->supply_volume, p->beta, x[T_PS], q.supply);
    double to_a = p->hose_conductance_a * (x[T_HA] - pa), to_b = p->hose_conductance_b * (x[T_HB] - pb);
    dx[T_HA] = p->hose_beta_a / p->hose_volume_a * (q.a - to_a);
    dx[T_HB] = p->hose_beta_b / p->hose_volume_b * (q.b - to_b);
    double across = internal_leak(c, pa, pb);
    double Va = p->dead_a + p->area_a * x[T_X], Vb = p->dead_b + p->area_b * (p->stroke - x[T_X]);
    dx[T_PA] = (to_a - across - loss(c, c->leak_a, pa) - p->area_a * v) / capacity(c, Va, pa, p->beta, c->hose_a);
    dx[T_PB] = (to_b + across - loss(c, c->leak_b, pb) + p->area_b * v) / capacity(c, Vb, pb, p->beta, c->hose_b);
    double dry = dry_friction(c, fabs(v), x[T_X], pa, pb, direction), mass = p->mass + payload_change(c);
    dx[T_X] = v;
    dx[T_V] = direction == 0 && dry > 0 ? 0 : (test_cylinder_drive(p, t, x) - direction * dry) / mass;
}

/* Play of the solenoid: the output is pushed along by the edges of its play. */
static void test_cylinder_settle(double *x, double u, const void *pv) {
    const TestCylinder *p = pv;
    double wanted = wanted_spool(p, x, u), half = 0.5 * p->play;
    x[T_PLAY] = fmin(fmax(x[T_PLAY], wanted - half), wanted + half);
}

static Contact test_cylinder_contact(double t, const double *x, double u, const void *pv) {
    (void)u;
    Contact contact = {test_cylinder_drive(pv, t, x), 0};
    contact.hold = dry_friction(pv, 0, x[T_X], x[T_PA], x[T_PB], (int)sign_of(contact.drive));
    return contact;
}

static int test_cylinder_sliding_state(const void *pv) { return is_dry(pv) ? T_V : -1; }

static int test_cylinder_inside(const double *x, const void *pv) {
    const TestCylinder *p = pv;
    return p->dead_a + p->area_a * x[T_X] > 0 && p->dead_b + p->area_b * (p->stroke - x[T_X]) > 0;
}

static void test_cylinder_output(const double *x, const void *pv, double *y) {
    (void)pv;
    y[0] = x[T_X];
    y[1] = x[T_S];
    y[2] = x[T_PA];
    y[3] = x[T_PB];
}

static const Machine test_cylinder = {
    T_STATES, 4, test_cylinder_derivative, test_cylinder_contact, test_cylinder_sliding_state, test_cylinder_inside,
    test_cylinder_output, test_cylinder_settle};
