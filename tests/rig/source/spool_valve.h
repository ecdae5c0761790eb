/* Differential cylinder behind a four-edge spool valve: spool dynamics, metering edges, chambers, mass. */
#include "common.h"

#define SPOOL(X)                                                                                           \
    COMMON(X)                                                                                              \
    X(frequency) X(damping) X(command_gain) X(offset) X(flow_gain) X(supply) X(tank)                         \
    X(area_a) X(area_b) X(dead_a) X(dead_b) X(stroke) X(beta) X(mass) X(load) X(viscous)                     \
    X(overlap_pa) X(overlap_at) X(overlap_pb) X(overlap_bt) X(flow_knee) X(flow_limit) X(supply_resistance)  \
    X(supply_volume) X(load_sensitivity) X(spring) X(line_laminar) X(line_turbulent)
typedef struct { SPOOL(RIG_FIELD) } Spool;

enum { S_S, S_SD, S_PA, S_PB, S_X, S_V, S_XR, S_VR, S_Z, S_U, S_PS, S_OA, S_OB, S_STATES };

static int spool_loose(const Spool *p) { return p->coupling_stiffness > 0; }

static double spool_rod(const Spool *p, const double *x) { return spool_loose(p) ? x[S_XR] : x[S_X]; }

typedef struct { double Va, Vb, pa, pb; } Sides;

static Sides spool_sides(const Spool *p, const double *x) {
    const Common *c = (const Common *)p;
    double xr = spool_rod(p, x);
    Sides k = {p->dead_a + p->area_a * xr, p->dead_b + p->area_b * (p->stroke - xr), x[S_PA], x[S_PB]};
    if (c->separates > 0) {
        k.pa = separated_pressure(c, x[S_OA], k.Va, p->beta);
        k.pb = separated_pressure(c, x[S_OB], k.Vb, p->beta);
    }
    return k;
}

/* Opening of one edge: past its overlap, bent over above the knee towards the limit. */
static double opening(const Spool *p, double s, double overlap) {
    double o = s - overlap;
    if (o <= 0) return 0;
    if (p->flow_limit > 0 && o > p->flow_knee) {
        double room = p->flow_limit - p->flow_knee;
        o = p->flow_knee + room * tanh((o - p->flow_knee) / room);
    }
    return o;
}

/* An orifice of conductance g [m3/(s.sqrt(Pa))]: square root of the pressure drop, laminar below about 1 kPa. */
static double orifice_alone(double g, double dp) { return g * dp / sqrt(sqrt(dp * dp + 1e6)); }

/* The same in series with a line that takes R q + K q|q|: from the closed form for a sharp orifice by Newton's method. */
static double through_line(const Spool *p, double g, double dp) {
    double R = p->line_laminar, K = p->line_turbulent, drop = fabs(dp);
    if (g <= 0 || (R <= 0 && K <= 0)) return orifice_alone(g, dp);
    double q = 2 * drop / (R + sqrt(R * R + 4 * (K + 1 / (g * g)) * drop));
    for (int i = 0; i < 6; i++) {
        double d = drop - R * q - K * q * fabs(q), w = d * d + 1e6, quarter = sqrt(sqrt(w));
        double slope = g * (1 - 0.5 * d * d / w) / quarter;
        q -= (q - g * d / quarter) / (1 + slope * (R + 2 * K * fabs(q)));
    }
    return sign_of(dp) * q;
}

/* One metering edge and the line behind it. */
static double orifice(const Spool *p, double t, double o, double dp) {
    double k = p->flow_gain * (1 + p->drift * t);
    if (p->load_sensitivity != 0) k *= 1 - p->load_sensitivity * dp / p->supply;
    return through_line(p, k * o, dp);
}

static double spool_drive(const Spool *p, double t, const double *x, double *dz, double *pin_force) {
    const Common *c = (const Common *)p;
    int loose = spool_loose(p);
    double xr = loose ? x[S_XR] : x[S_X], vr = loose ? x[S_VR] : x[S_V];
    Sides o = spool_sides(p, x);
    double force = o.pa * p->area_a - o.pb * p->area_b - warmed(c, p->viscous, t) * vr;
    force += stop_force(c, xr, vr) - bristles(c, vr, x[S_Z], dz);
    *pin_force = loose ? coupling_force(c, xr - x[S_X], vr - x[S_V]) : 0;
    return loose ? force - *pin_force : force - p->load - external_force(c) - p->spring * x[S_X];
}

/* The stated mass is that of all that moves: a rod of its own is part of it. */
static double spool_mass(const Spool *p) {
    return p->mass + payload_change((const Common *)p) - (spool_loose(p) ? p->rod_mass : 0);
}

static void spool_motion(const Spool *p, double t, const double *x, int direction, double dry, double *dx) {
    double pin, drive = spool_drive(p, t, x, &dx[S_Z], &pin) - direction * dry, held = direction == 0 && dry > 0;
    dx[S_X] = x[S_V];
    if (!spool_loose(p)) {
        dx[S_V] = held ? 0 : drive / spool_mass(p);
        dx[S_XR] = dx[S_VR] = 0;
        return;
    }
    double load = p->load + external_force((const Common *)p) + p->spring * x[S_X];
    dx[S_V] = (pin - load) / spool_mass(p);
    dx[S_XR] = x[S_VR];
    dx[S_VR] = held ? 0 : drive / p->rod_mass;
}

static void spool_derivative(double t, const double *x, double u, const void *pv, int direction, double *dx) {
    const Spool *p = pv;
    const Common *c = pv;
    Sides side = spool_sides(p, x);
    double xr = spool_rod(p, x), vr = spool_loose(p) ? x[S_VR] : x[S_V];
    double pa = side.pa, pb = side.pb, s = x[S_S], wn = p->frequency;
    double command = c->command_lag > 0 ? x[S_U] : u;
    dx[S_U] = c->command_lag > 0 ? (u - x[S_U]) / c->command_lag : 0;
    dx[S_S] = x[S_SD];
    dx[S_SD] = wn * wn * (p->command_gain * command + p->offset - s) - 2 * p->damping * wn * x[S_SD];
    double ps = p->supply_resistance > 0 ? x[S_PS] : p->supply;
    double q_pa = orifice(p, t, opening(p, s, p->overlap_pa), ps - pa);
    double q_at = orifice(p, t, opening(p, -s, p->overlap_at), pa - p->tank);
    double q_pb = orifice(p, t, opening(p, -s, p->overlap_pb), ps - pb);
    double q_bt = orifice(p, t, opening(p, s, p->overlap_bt), pb - p->tank);
    double across = internal_leak(c, pa, pb);
    double qa = q_pa - q_at - across - loss(c, c->leak_a, pa), qb = q_pb - q_bt + across - loss(c, c->leak_b, pb);
    dx[S_PA] = (qa - p->area_a * vr) / capacity(c, side.Va, pa, p->beta, c->hose_a);
    dx[S_PB] = (qb + p->area_b * vr) / capacity(c, side.Vb, pb, p->beta, c->hose_b);
    dx[S_OA] = c->separates > 0 ? oil_gained(qa, x[S_OA], side.Va) : 0;
    dx[S_OB] = c->separates > 0 ? oil_gained(qb, x[S_OB], side.Vb) : 0;
    dx[S_PS] = 0;
    if (p->supply_resistance > 0)
        dx[S_PS] = p->beta / p->supply_volume * ((p->supply - ps) / p->supply_resistance - q_pa - q_pb);
    spool_motion(p, t, x, direction, dry_friction(c, fabs(vr), xr, pa, pb, direction), dx);
}

static Contact spool_contact(double t, const double *x, double u, const void *pv) {
    const Spool *p = pv;
    double dz, pin;
    (void)u;
    Contact contact = {spool_drive(p, t, x, &dz, &pin), 0};
    Sides o = spool_sides(p, x);
    contact.hold = dry_friction((const Common *)p, 0, spool_rod(p, x), o.pa, o.pb, (int)sign_of(contact.drive));
    return contact;
}

static int spool_sliding_state(const void *pv) {
    const Spool *p = pv;
    if (!is_dry(pv)) return -1;
    return spool_loose(p) ? S_VR : S_V;
}

static int spool_inside(const double *x, const void *pv) {
    const Spool *p = pv;
    Sides o = spool_sides(p, x);
    return o.Va > 0 && o.Vb > 0;
}

static void spool_output(const double *x, const void *pv, double *y) {
    Sides o = spool_sides(pv, x);
    y[0] = x[S_X];
    y[1] = x[S_S];
    y[2] = o.pa;
    y[3] = o.pb;
    y[4] = x[S_V];
}

static const Machine spool_valve = {
    S_STATES, 5, spool_derivative, spool_contact, spool_sliding_state, spool_inside, spool_output, NULL};
