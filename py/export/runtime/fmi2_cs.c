/* The FMI 2.0 face of the core: Co-Simulation. */
#include "fmi2_face.h"

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    size_t k;
    if (!c || (n > 0 && (!vr || !order || !value))) return fmi2Error;
    for (k = 0; k < n; k++)
        if (order[k] != 1) return ht2_refuse(c, "only first derivatives of inputs are used");
    return ht2_answer(c, ht_set_slope(&((component *)c)->core, vr, n, value));
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
    (void)vr, (void)order, (void)value;
    if (c && n == 0) return fmi2OK;
    return ht2_refuse(c, "derivatives of outputs are not available (maxOutputDerivativeOrder is 0)");
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean no_return) {
    fmi2Status status;
    (void)no_return;
    if (!c) return fmi2Error;
    status = ht2_answer(c, ht_step(&((component *)c)->core, time, size));
    ht2_tell_domain(c);
    return status;
}

fmi2Status fmi2CancelStep(fmi2Component c) { return ht2_refuse(c, "steps are synchronous, there is none to cancel"); }

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    (void)kind, (void)value;
    return ht2_refuse(c, "steps are synchronous, their status is what fmi2DoStep returned");
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (!c || !value || kind != fmi2LastSuccessfulTime) return ht2_refuse(c, "only fmi2LastSuccessfulTime is a Real status");
    *value = ht_time(&((component *)c)->core);
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    (void)kind, (void)value;
    return ht2_refuse(c, "there is no Integer status");
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (!c || !value || kind != fmi2Terminated) return ht2_refuse(c, "only fmi2Terminated is a Boolean status");
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    (void)kind, (void)value;
    return ht2_refuse(c, "there is no String status");
}
