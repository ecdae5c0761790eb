/* A plant for masters to be tried on: T x' = gain * u - x where `on`, else T x' = -x, solved exactly over a step.
   `state` is x, `force` = x + u follows the input at once. In Co-Simulation its state is disturbed by whoever reads
   between setting an input and the step, as FMI 2.0.5 (p. 109) allows it to be. In Model Exchange it is pure, or has
   the fault that FAULT names. */
#ifndef FOLLOWER_H
#define FOLLOWER_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { U, SLOPE, STATE, FORCE, START, RATE, REALS }; /* value references of the real variables */
enum { GAIN = 10, GAIN_SEEN = 11, ON = 20, ON_SEEN = 21 };
enum { NO_FAULT, OLD_INPUTS, TIME_RISES, INPUTS_AT_EVENTS, KEPT_RATE };

#ifndef FAULT
#define FAULT NO_FAULT
#endif
#define T 0.1

typedef struct {
    double u, slope, x, start, time, latest, taken, rate;
    int gain, on, initialising, written, disturbed, known;
} plant;

static void begin(plant *p) {
    memset(p, 0, sizeof *p);
    p->gain = p->on = p->initialising = 1;
}

static double target(const plant *p, double u) { return p->on ? p->gain * u : 0.0; }

/* the exact solution under u + slope t */
static void walk(plant *p, double h) {
    double c = target(p, p->u), s = target(p, p->slope), e = exp(-h / T);
    if (p->disturbed) p->x += 0.5;
    p->x = c + s * (h - T) + (p->x - c + s * T) * e;
    p->u += p->slope * h;
    p->slope = 0.0;
    p->written = p->disturbed = 0;
}

static double rate(plant *p) {
    double u = FAULT == INPUTS_AT_EVENTS && !p->initialising ? p->taken : p->u, found;
    if (FAULT == TIME_RISES && p->time > p->latest) p->latest = p->time;
    found = (target(p, FAULT == OLD_INPUTS ? p->taken : u) - p->x) / T;
    if (FAULT == TIME_RISES) found += 0.1 * p->latest;
    if (FAULT == OLD_INPUTS) p->taken = p->u; /* the inputs of the question before */
    if (FAULT == KEPT_RATE && p->known) return p->rate; /* until the time is set */
    p->known = 1;
    return p->rate = found;
}

static double get_real(plant *p, unsigned reference) {
    if (p->written) p->disturbed = 1;
    switch (reference) {
        case U: return p->u;
        case SLOPE: return p->slope;
        case STATE: return p->initialising ? p->start : p->x;
        case FORCE: return (p->initialising ? p->start : p->x) + p->u;
        case START: return p->start;
        case RATE: return rate(p);
        default: return 0.0;
    }
}

static void set_real(plant *p, unsigned reference, double value) {
    p->written = !p->initialising;
    if (reference == U) p->u = value;
    if (reference == START) p->x = p->start = value;
}

static int get_whole(plant *p, unsigned reference) {
    if (p->written) p->disturbed = 1;
    return reference == GAIN || reference == GAIN_SEEN ? p->gain : p->on;
}

static void set_whole(plant *p, unsigned reference, int value) {
    p->written = !p->initialising;
    *(reference == GAIN ? &p->gain : &p->on) = value;
}

#endif
