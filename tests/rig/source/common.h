/* What both machines share: friction, leakage, oil, stops, and the coupling between rod and load.
 * Every field is neutral at zero (absent) unless its name says otherwise. SI units throughout.
 * `now` is the middle of the present stretch between breakpoints: timed switches look at it, so that the last stage of
 * a step that ends at the switch still sees the state of affairs before it. */
#ifndef RIG_COMMON_H
#define RIG_COMMON_H
#include <math.h>

#define FRICTION(X)                                                                                        \
    X(coulomb) X(breakaway) X(stribeck_velocity) X(asymmetry) X(ripple) X(ripple_length) X(per_pressure)     \
    X(bristle_stiffness) X(bristle_damping) X(bristle_kinetic) X(bristle_static) X(bristle_velocity)
#define OIL(X)                                                                                             \
    X(leak) X(leak_turbulent) X(leak_a) X(leak_b) X(air) X(air_exponent) X(hose_a) X(hose_b)                 \
    X(relief_pressure) X(relief_conductance) X(refill_pressure) X(refill_conductance)                        \
    X(separates) X(lowest_pressure)
#define BODY(X)                                                                                            \
    X(stop_low) X(stop_high) X(stop_stiffness) X(stop_damping) X(coupling_stiffness) X(coupling_damping)     \
    X(coupling_gap) X(rod_mass) X(constant_force) X(push_force) X(push_start) X(push_end)                    \
    X(payload_step) X(payload_time) X(command_lag) X(drift) X(warming) X(warming_time) X(now)
#define COMMON(X) FRICTION(X) OIL(X) BODY(X)

#define RIG_FIELD(name) double name;
#define RIG_NAME(name) #name ","
typedef struct { COMMON(RIG_FIELD) } Common;

/* What the event logic needs of the sliding body: the force that would move it, and the force that holds it. */
typedef struct { double drive, hold; } Contact;

typedef struct {
    int states, outputs;
    void (*derivative)(double t, const double *x, double u, const void *p, int direction, double *dx);
    Contact (*contact)(double t, const double *x, double u, const void *p);
    int (*sliding_state)(const void *p);   /* index of the velocity that sticks, or -1: no exact friction */
    int (*inside)(const double *x, const void *p);   /* volumes open, linkage short of its dead centre */
    void (*output)(const double *x, const void *p, double *y);
    void (*settle)(double *x, double u, const void *p);   /* states that jump with their surroundings; or NULL */
} Machine;

static inline double sign_of(double v) { return (v > 0) - (v < 0); }

/* Exact dry friction while sliding in `direction`, at speed |v|. */
static inline double dry_friction(const Common *c, double speed, double x, double pa, double pb, int direction) {
    double force = c->coulomb + c->per_pressure * (fabs(pa) + fabs(pb));
    double ratio = c->stribeck_velocity > 0 ? speed / c->stribeck_velocity : 0;
    if (c->breakaway > 0)
        force += c->breakaway * (c->stribeck_velocity > 0 ? exp(-ratio * ratio) : speed == 0);
    if (c->ripple > 0)
        force *= 1 + c->ripple * sin(2 * M_PI * x / c->ripple_length);
    return force * (1 + direction * c->asymmetry);
}

/* Whether there is exact dry friction at all. */
static inline int is_dry(const Common *c) { return c->coulomb > 0 || c->breakaway > 0 || c->per_pressure > 0; }

/* LuGre bristles: z' = v - s0 |v| z / g(v), F = s0 z + s1 z'. */
static inline double bristles(const Common *c, double v, double z, double *dz) {
    if (c->bristle_stiffness <= 0) { *dz = 0; return 0; }
    double ratio = v / c->bristle_velocity;
    double g = c->bristle_kinetic + (c->bristle_static - c->bristle_kinetic) * exp(-ratio * ratio);
    *dz = v - c->bristle_stiffness * fabs(v) * z / g;
    return c->bristle_stiffness * z + c->bristle_damping * *dz;
}

/* Internal leak from a to b: laminar, and turbulent with a laminar start below 1 kPa. */
static inline double internal_leak(const Common *c, double pa, double pb) {
    double dp = pa - pb;
    return c->leak * dp + c->leak_turbulent * dp / sqrt(sqrt(dp * dp + 1e6));
}

/* Flow out of a chamber past its own seals and relief valve, less what an anti-cavitation valve lets in. */
static inline double loss(const Common *c, double leak, double p) {
    double q = leak * p;
    if (c->relief_conductance > 0 && p > c->relief_pressure) q += c->relief_conductance * (p - c->relief_pressure);
    if (c->refill_conductance > 0 && p < c->refill_pressure) q -= c->refill_conductance * (c->refill_pressure - p);
    return q;
}

/* Capacity dV/dp of a chamber of volume V: oil, free air compressed polytropically, hose. */
static inline double capacity(const Common *c, double V, double p, double beta, double hose) {
    if (c->air <= 0) return V / beta + hose;
    double p0 = 101325.0, q = p > 1e3 ? p : 1e3;
    double gas = c->air * pow(p0 / q, 1 / c->air_exponent);
    double liquid = (1 - c->air) * exp(-(q - p0) / beta);
    return V * (liquid / beta + gas / (c->air_exponent * q)) / (liquid + gas) + hose;
}

/* Column separation: the state is the oil in a chamber as a volume `oil` at the lowest pressure it bears (release of
 * air, vapour). The chamber holds more than its volume: the oil is compressed, rho = rho_0 exp((p - p_0)/beta); less: a
 * void of V - oil opens, at p_0, and must be refilled before pressure can rise. */
static inline double separated_pressure(const Common *c, double oil, double V, double beta) {
    return oil > V ? c->lowest_pressure + beta * log(oil / V) : c->lowest_pressure;
}

/* A flow at the pressure of the chamber as a flow of oil at its lowest pressure. */
static inline double oil_gained(double flow, double oil, double V) { return oil > V ? flow * oil / V : flow; }

/* End stops (Hunt-Crossley: no pull, continuous at contact); the force pushes back into the stroke. */
static inline double stop_force(const Common *c, double x, double v) {
    if (c->stop_stiffness <= 0) return 0;
    if (x < c->stop_low) return fmax(0, c->stop_stiffness * (c->stop_low - x) * (1 - c->stop_damping * v));
    if (x > c->stop_high) return -fmax(0, c->stop_stiffness * (x - c->stop_high) * (1 + c->stop_damping * v));
    return 0;
}

/* Force through the pin from rod to load: spring and damper behind a clearance of +-gap/2. */
static inline double coupling_force(const Common *c, double dx, double dv) {
    double half = 0.5 * c->coupling_gap;
    double stretch = dx > half ? dx - half : dx < -half ? dx + half : 0;
    if (stretch == 0 && half > 0) return 0;
    double force = c->coupling_stiffness * stretch + c->coupling_damping * dv;
    return half > 0 && force * stretch < 0 ? 0 : force;
}

static inline double external_force(const Common *c) {
    return c->constant_force + (c->now >= c->push_start && c->now < c->push_end ? c->push_force : 0);
}

static inline double payload_change(const Common *c) { return c->now >= c->payload_time ? c->payload_step : 0; }

static inline double warmed(const Common *c, double value, double t) {
    return c->warming == 0 ? value : value * (1 - c->warming * (1 - exp(-t / c->warming_time)));
}
#endif
