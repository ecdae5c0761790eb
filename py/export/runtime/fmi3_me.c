/* The FMI 3.0 face of the core: Model Exchange. */
#include "fmi3_face.h"

static ht_instance *core_of(fmi3Instance c) { return &((component *)c)->core; }

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) {
    return c ? ht3_answer(c, ht_enter_continuous(core_of(c))) : fmi3Error;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no_return, fmi3Boolean *event, fmi3Boolean *terminate) {
    int restart;
    fmi3Status status;
    (void)no_return;
    if (!c || !event || !terminate) return fmi3Error;
    status = ht3_answer(c, ht_step_completed(core_of(c), &restart));
    *event = restart ? fmi3True : fmi3False;
    *terminate = fmi3False;
    return status;
}

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) { return c ? ht3_answer(c, ht_set_time(core_of(c), time)) : fmi3Error; }

fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) {
    return c && (x || !n) ? ht3_answer(c, ht_set_states(core_of(c), x, n)) : fmi3Error;
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 xdot[], size_t n) {
    return c && (xdot || !n) ? ht3_answer(c, ht_get_derivatives(core_of(c), xdot, n)) : fmi3Error;
}

fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 indicators[], size_t n) {
    (void)indicators;
    return c ? ht3_answer(c, ht_get_indicators(core_of(c), n)) : fmi3Error;
}

fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    return c && (x || !n) ? ht3_answer(c, ht_get_states(core_of(c), x, n)) : fmi3Error;
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 nominal[], size_t n) {
    return c && (nominal || !n) ? ht3_answer(c, ht_get_nominals(core_of(c), nominal, n)) : fmi3Error;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) {
    if (!c || !n) return fmi3Error;
    *n = 0;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) {
    if (!c || !n) return fmi3Error;
    *n = core_of(c)->model->states;
    return fmi3OK;
}
