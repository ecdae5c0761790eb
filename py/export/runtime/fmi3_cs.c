/* The FMI 3.0 face of the core: Co-Simulation. */
#include "fmi3_face.h"

fmi3Status fmi3EnterStepMode(fmi3Instance c) {
    return ht3_refuse(c, "this FMU has no event mode in Co-Simulation to come from (hasEventMode is false)");
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Int32 order[],
                                    fmi3Float64 value[], size_t values) {
    (void)vr, (void)order, (void)value;
    if (c && n + values == 0) return fmi3OK;
    return ht3_refuse(c, "derivatives of outputs are not available (maxOutputDerivativeOrder is 0)");
}

/* Every internal step is final, and outputs can be read at its end. Before the communication point inputs can be moved,
   and doStep can return early, at once or at a time still to come. */
double ht3_watch(ht_instance *core, double end) {
    component *c = (component *)core;
    double now = ht_time(core), wanted = now;
    fmi3Boolean requested = fmi3False, can = c->early_return && now < end;
    c->update(c->environment, now, fmi3True, core->model->method != HT_SAMPLED, fmi3True, can, &requested, &wanted);
    if (!requested || !can || !(wanted < end)) return end;
    return wanted > now ? wanted : now;
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 size, fmi3Boolean no_return, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last) {
    ht_instance *core;
    fmi3Status status;
    (void)no_return;
    if (!c || !event || !terminate || !early || !last) return fmi3Error;
    core = &((component *)c)->core;
    *event = *terminate = *early = fmi3False;
    status = ht3_answer(c, ht_step(core, time, size));
    ht3_tell_domain(c);
    *last = ht_time(core);
    *early = status == fmi3OK && *last < time + size;
    return status;
}
