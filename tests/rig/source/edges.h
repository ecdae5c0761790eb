/* A spool with four metering edges between a supply, a tank and two lines, and the supply behind a resistance. */
#ifndef RIG_EDGES_H
#define RIG_EDGES_H
#include "common.h"

#define EDGES(X)                                                                                           \
    X(frequency) X(damping) X(flow_gain) X(supply) X(tank) X(supply_resistance) X(supply_volume)             \
    X(overlap_pa) X(overlap_at) X(overlap_pb) X(overlap_bt)

/* Flows into the two lines and out of the supply [m3/s]. */
typedef struct { double a, b, supply; } Flows;

typedef struct { double pressure, flow_gain, tank, pa_edge, at_edge, pb_edge, bt_edge; } Valve;

/* Square root of the pressure drop, laminar below 0.1 bar. */
static inline double edge(double gain, double opening, double dp) {
    return opening > 0 ? gain * opening * dp / sqrt(sqrt(dp * dp + 1e8)) : 0;
}

static inline Flows four_edges(const Valve *v, double s, double pa, double pb) {
    double in_a = edge(v->flow_gain, s - v->pa_edge, v->pressure - pa);
    double in_b = edge(v->flow_gain, -s - v->pb_edge, v->pressure - pb);
    double out_a = edge(v->flow_gain, -s - v->at_edge, pa - v->tank);
    double out_b = edge(v->flow_gain, s - v->bt_edge, pb - v->tank);
    Flows q = {in_a - out_a, in_b - out_b, in_a + in_b};
    return q;
}

/* The valve of a machine whose fields are those of EDGES; `ps` is its state of the supply. */
#define VALVE_OF(p, ps)                                                                                    \
    {(p)->supply_resistance > 0 ? (ps) : (p)->supply, (p)->flow_gain, (p)->tank,                             \
     (p)->overlap_pa, (p)->overlap_at, (p)->overlap_pb, (p)->overlap_bt}

/* Rate of the pressure in the supply's volume, fed through its resistance. */
static inline double supply_rate(double held, double resistance, double volume, double beta, double ps, double out) {
    return resistance > 0 ? beta / volume * ((held - ps) / resistance - out) : 0;
}
#endif
