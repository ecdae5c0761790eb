/* Model Exchange: the importer integrates. Setting time, states or inputs, in any order, only marks what follows from
   them as stale; it is computed anew when it is asked for. There are no events: all laws are smooth. */
#include <string.h>

#include "internal.h"

static ht_status integrating(ht_instance *s, const char *what) {
    if (ht_phase_of(s) == HT_EVENT) return HT_OK;
    return ht_expect(s, HT_CONTINUOUS, what);
}

static ht_status of_states(ht_instance *s, size_t n) {
    if (n == s->model->states) return HT_OK;
    return ht_fail(s, HT_ERROR, "there are %lu continuous states, not %lu", (unsigned long)s->model->states, (unsigned long)n);
}

ht_status ht_enter_event(ht_instance *s) {
    if (ht_expect(s, HT_CONTINUOUS, "entering event mode") != HT_OK) return HT_ERROR;
    ht_book(s)[PHASE] = HT_EVENT;
    return HT_OK;
}

ht_status ht_enter_continuous(ht_instance *s) {
    if (ht_expect(s, HT_EVENT, "entering continuous-time mode") != HT_OK) return HT_ERROR;
    ht_book(s)[PHASE] = HT_CONTINUOUS;
    ht_book(s)[ASKED] = ht_book(s)[MOVED] = 0.0;
    return HT_OK;
}

ht_status ht_discrete_update(ht_instance *s) { return ht_expect(s, HT_EVENT, "updating discrete states"); }

static int inputs_are_others(const ht_instance *s) {
    return memcmp(ht_asked(s), ht_values(s, HT_INPUT), s->model->inputs * sizeof(double)) != 0;
}

/* Whether inputs move within the steps of the importer, or only between them. */
static void watch_inputs(ht_instance *s) {
    if (ht_book(s)[ASKED] != 0.0 && inputs_are_others(s)) ht_book(s)[MOVED] = 1.0;
    ht_book(s)[ASKED] = 1.0;
    memcpy(ht_asked(s), ht_values(s, HT_INPUT), s->model->inputs * sizeof(double));
}

/* An importer that holds its inputs through a step and moves them at its end makes a jump of them. A solver of many
   steps that is not told takes the jump for an error of its own, and gives up or loses its accuracy. */
ht_status ht_step_completed(ht_instance *s, int *event) {
    *event = 0;
    if (ht_expect(s, HT_CONTINUOUS, "completing a step") != HT_OK) return HT_ERROR;
    *event = ht_book(s)[ASKED] != 0.0 && ht_book(s)[MOVED] == 0.0 && inputs_are_others(s);
    ht_book(s)[ASKED] = ht_book(s)[MOVED] = 0.0;
    return HT_OK;
}

ht_status ht_set_time(ht_instance *s, double time) {
    if (integrating(s, "setting the time") != HT_OK) return HT_ERROR;
    if (!ht_finite(&time, 1)) return ht_fail(s, HT_ERROR, "the time cannot be %g s", time);
    ht_values(s, HT_TIME)[0] = time;
    ht_book(s)[STALE] = 1.0;
    return HT_OK;
}

ht_status ht_set_states(ht_instance *s, const double *x, size_t n) {
    size_t i;
    if (integrating(s, "setting the states") != HT_OK || of_states(s, n) != HT_OK) return HT_ERROR;
    for (i = 0; i < n; i++)
        if (!ht_finite(x + i, 1))
            return ht_fail(s, HT_DISCARD, "state '%s' cannot be %g", s->model->labels[ht_place_of(s->model, HT_STATE) + i], x[i]);
    memcpy(ht_values(s, HT_STATE), x, n * sizeof(double));
    ht_book(s)[STALE] = 1.0;
    return HT_OK;
}

ht_status ht_get_states(ht_instance *s, double *x, size_t n) {
    ht_phase phase = ht_phase_of(s);
    ht_status status = HT_OK;
    if (phase == HT_INITIALISING) status = ht_refresh(s);
    if (status != HT_OK) return status;
    if (phase != HT_INITIALISING && phase != HT_TERMINATED && integrating(s, "reading the states") != HT_OK) return HT_ERROR;
    if (of_states(s, n) != HT_OK) return HT_ERROR;
    memcpy(x, ht_values(s, HT_STATE), n * sizeof(double));
    return HT_OK;
}

ht_status ht_get_derivatives(ht_instance *s, double *xdot, size_t n) {
    ht_phase phase = ht_phase_of(s);
    ht_status status;
    size_t i;
    if (phase != HT_INITIALISING && phase != HT_TERMINATED && integrating(s, "reading the derivatives") != HT_OK) return HT_ERROR;
    if (of_states(s, n) != HT_OK) return HT_ERROR;
    status = phase == HT_TERMINATED ? HT_OK : ht_refresh(s);
    if (status != HT_OK) return status;
    for (i = 0; i < n; i++)
        if (!ht_finite(ht_values(s, HT_DERIVATIVE) + i, 1))
            return ht_fail(s, HT_DISCARD, "'%s' is not finite at t = %.9g s",
                           s->model->labels[ht_place_of(s->model, HT_DERIVATIVE) + i], ht_time(s));
    memcpy(xdot, ht_values(s, HT_DERIVATIVE), n * sizeof(double));
    if (phase == HT_CONTINUOUS) watch_inputs(s);
    return HT_OK;
}

ht_status ht_get_nominals(ht_instance *s, double *nominal, size_t n) {
    if (ht_phase_of(s) == HT_INSTANTIATED) return ht_fail(s, HT_ERROR, "nominal values are known from initialization mode on");
    if (of_states(s, n) != HT_OK) return HT_ERROR;
    memcpy(nominal, s->model->nominals, n * sizeof(double));
    return HT_OK;
}

ht_status ht_get_indicators(ht_instance *s, size_t n) {
    if (n == 0) return HT_OK;
    return ht_fail(s, HT_ERROR, "there are no event indicators, not %lu", (unsigned long)n);
}
