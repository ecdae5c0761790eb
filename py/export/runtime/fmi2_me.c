/* The FMI 2.0 face of the core: Model Exchange. */
#include "fmi2_face.h"

static ht_instance *core_of(fmi2Component c) { return &((component *)c)->core; }

fmi2Status fmi2EnterEventMode(fmi2Component c) { return c ? ht2_answer(c, ht_enter_event(core_of(c))) : fmi2Error; }

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    if (!c || !info) return fmi2Error;
    info->newDiscreteStatesNeeded = info->terminateSimulation = fmi2False;
    info->nominalsOfContinuousStatesChanged = info->valuesOfContinuousStatesChanged = fmi2False;
    info->nextEventTimeDefined = fmi2False;
    info->nextEventTime = 0.0;
    return ht2_answer(c, ht_discrete_update(core_of(c)));
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    return c ? ht2_answer(c, ht_enter_continuous(core_of(c))) : fmi2Error;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_return, fmi2Boolean *event, fmi2Boolean *terminate) {
    int restart;
    fmi2Status status;
    (void)no_return;
    if (!c || !event || !terminate) return fmi2Error;
    status = ht2_answer(c, ht_step_completed(core_of(c), &restart));
    *event = restart ? fmi2True : fmi2False;
    *terminate = fmi2False;
    return status;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) { return c ? ht2_answer(c, ht_set_time(core_of(c), time)) : fmi2Error; }

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    return c && (x || !n) ? ht2_answer(c, ht_set_states(core_of(c), x, n)) : fmi2Error;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real xdot[], size_t n) {
    return c && (xdot || !n) ? ht2_answer(c, ht_get_derivatives(core_of(c), xdot, n)) : fmi2Error;
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t n) {
    (void)indicators;
    return c ? ht2_answer(c, ht_get_indicators(core_of(c), n)) : fmi2Error;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    return c && (x || !n) ? ht2_answer(c, ht_get_states(core_of(c), x, n)) : fmi2Error;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominal[], size_t n) {
    return c && (nominal || !n) ? ht2_answer(c, ht_get_nominals(core_of(c), nominal, n)) : fmi2Error;
}
