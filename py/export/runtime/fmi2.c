/* The FMI 2.0 face of the core: Co-Simulation. Translates phases, logging and memory; computes nothing. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core.h"
#include "fmi2Functions.h"

typedef struct {
    ht_instance core;
    fmi2CallbackFunctions callbacks;
    fmi2Boolean logging;
    char *name;
} component;

/* ---- logging and status: failures are always logged, events when logging is on ---- */

static void say(component *c, fmi2Status status, const char *message) {
    static const char *const categories[] = {"logEvents", "logEvents", "logStatusDiscard", "logStatusError"};
    if (c->callbacks.logger && (c->logging || status != fmi2OK))
        c->callbacks.logger(c->callbacks.componentEnvironment, c->name, status, categories[status], "%s", message);
}

static fmi2Status answer(component *c, ht_status status) {
    fmi2Status out = status == HT_OK ? fmi2OK : status == HT_DISCARD ? fmi2Discard : fmi2Error;
    if (out != fmi2OK) say(c, out, c->core.message);
    return out;
}

static fmi2Status refuse(component *c, const char *why) {
    if (c) say(c, fmi2Error, why);
    return fmi2Error;
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    if (!c || (n > 0 && !categories)) return fmi2Error;
    ((component *)c)->logging = on;
    return fmi2OK;
}

/* ---- life ---- */

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    const ht_model *model = &ht_the_model;
    size_t own = (sizeof(component) + 15) / 16 * 16, length;
    char *memory;
    component *c;
    component early;
    (void)resources, (void)visible;
    if (!functions) return NULL;
    memset(&early, 0, sizeof early);
    early.callbacks = *functions;
    early.name = (char *)(name ? name : "");
    if (!name || !*name) return refuse(&early, "an instance needs a name"), NULL;
    if (!guid || strcmp(guid, model->guid) != 0) return refuse(&early, "the GUID is not the one of this FMU"), NULL;
    if (type != fmi2CoSimulation) return refuse(&early, "this FMU is for Co-Simulation only"), NULL;
    length = strlen(name) + 1;
    memory = functions->allocateMemory ? functions->allocateMemory(1, own + ht_bytes(model) + length)
                                       : calloc(1, own + ht_bytes(model) + length);
    if (!memory) return refuse(&early, "out of memory"), NULL;
    memset(memory, 0, own + ht_bytes(model) + length);
    c = (component *)memory;
    c->callbacks = *functions;
    c->logging = logging;
    c->name = memory + own + ht_bytes(model);
    memcpy(c->name, name, length);
    ht_place(&c->core, model, memory + own);
    return c;
}

void fmi2FreeInstance(fmi2Component c) {
    component *own = c;
    if (!own) return;
    if (!own->callbacks.allocateMemory) {
        free(own);
    } else if (own->callbacks.freeMemory) {
        own->callbacks.freeMemory(own);
    }
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop) {
    (void)tolerance_defined, (void)tolerance;
    return c ? answer(c, ht_setup(&((component *)c)->core, start, stop_defined, stop)) : fmi2Error;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    return c ? answer(c, ht_enter_initialisation(&((component *)c)->core)) : fmi2Error;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    fmi2Status status = c ? answer(c, ht_exit_initialisation(&((component *)c)->core)) : fmi2Error;
    if (status == fmi2OK) say(c, fmi2OK, "the initial states are computed");
    return status;
}

fmi2Status fmi2Terminate(fmi2Component c) { return c ? answer(c, ht_terminate(&((component *)c)->core)) : fmi2Error; }

fmi2Status fmi2Reset(fmi2Component c) {
    if (!c) return fmi2Error;
    ht_reset(&((component *)c)->core);
    return fmi2OK;
}

/* ---- variables: all are Real ---- */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    if (!c || (n > 0 && (!vr || !value))) return fmi2Error;
    return answer(c, ht_get(&((component *)c)->core, vr, n, value));
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    if (!c || (n > 0 && (!vr || !value))) return fmi2Error;
    return answer(c, ht_set(&((component *)c)->core, vr, n, value));
}

static fmi2Status none_of_type(component *c, size_t n, const char *type) {
    char text[80];
    if (!c) return fmi2Error;
    if (n == 0) return fmi2OK;
    sprintf(text, "this FMU has no variables of type %.16s", type);
    return refuse(c, text);
}

#define NO_VARIABLES(type)                                                                                         \
    fmi2Status fmi2Get##type(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2##type value[]) {       \
        (void)vr, (void)value;                                                                                     \
        return none_of_type(c, n, #type);                                                                          \
    }                                                                                                              \
    fmi2Status fmi2Set##type(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2##type value[]) { \
        (void)vr, (void)value;                                                                                     \
        return none_of_type(c, n, #type);                                                                          \
    }

NO_VARIABLES(Integer)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)

/* ---- the whole state ---- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    ht_instance *core;
    size_t size;
    if (!c || !state) return fmi2Error;
    core = &((component *)c)->core;
    size = ht_doubles(core->model) * sizeof(double);
    if (!*state) *state = malloc(size);
    if (!*state) return refuse(c, "out of memory");
    memcpy(*state, core->data, size);
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    ht_instance *core;
    if (!c || !state) return fmi2Error;
    core = &((component *)c)->core;
    memcpy(core->data, state, ht_doubles(core->model) * sizeof(double));
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (!c) return fmi2Error;
    if (state && *state) {
        free(*state);
        *state = NULL;
    }
    return fmi2OK;
}

/* Serialized: the GUID with its closing zero, then the flat state. */
static size_t serialized_size(const ht_model *m) { return strlen(m->guid) + 1 + ht_doubles(m) * sizeof(double); }

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    if (!c || !state || !size) return fmi2Error;
    *size = serialized_size(((component *)c)->core.model);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    const ht_model *m;
    size_t head;
    if (!c || !state || !bytes) return fmi2Error;
    m = ((component *)c)->core.model;
    head = strlen(m->guid) + 1;
    if (size < serialized_size(m)) return refuse(c, "the buffer is too small for the serialized state");
    memcpy(bytes, m->guid, head);
    memcpy(bytes + head, state, ht_doubles(m) * sizeof(double));
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    const ht_model *m;
    size_t head;
    if (!c || !state || !bytes) return fmi2Error;
    m = ((component *)c)->core.model;
    head = strlen(m->guid) + 1;
    if (size < serialized_size(m) || memcmp(bytes, m->guid, head) != 0)
        return refuse(c, "the bytes are not a state of this FMU");
    if (!*state) *state = malloc(ht_doubles(m) * sizeof(double));
    if (!*state) return refuse(c, "out of memory");
    memcpy(*state, bytes + head, ht_doubles(m) * sizeof(double));
    return fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t unknowns,
                                        const fmi2ValueReference known[], size_t knowns, const fmi2Real seed[],
                                        fmi2Real sensitivity[]) {
    if (!c || (unknowns > 0 && (!unknown || !sensitivity)) || (knowns > 0 && (!known || !seed))) return fmi2Error;
    return answer(c, ht_directional(&((component *)c)->core, unknown, unknowns, known, knowns, seed, sensitivity));
}

/* ---- Co-Simulation ---- */

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    size_t k;
    if (!c || (n > 0 && (!vr || !order || !value))) return fmi2Error;
    for (k = 0; k < n; k++)
        if (order[k] != 1) return refuse(c, "only first derivatives of inputs are used");
    return answer(c, ht_set_slope(&((component *)c)->core, vr, n, value));
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
    (void)vr, (void)order, (void)value;
    if (c && n == 0) return fmi2OK;
    return refuse(c, "derivatives of outputs are not available (maxOutputDerivativeOrder is 0)");
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean no_return) {
    (void)no_return;
    return c ? answer(c, ht_step(&((component *)c)->core, time, size)) : fmi2Error;
}

fmi2Status fmi2CancelStep(fmi2Component c) { return refuse(c, "steps are synchronous, there is none to cancel"); }

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    (void)kind, (void)value;
    return refuse(c, "steps are synchronous, their status is what fmi2DoStep returned");
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (!c || !value || kind != fmi2LastSuccessfulTime) return refuse(c, "only fmi2LastSuccessfulTime is a Real status");
    *value = ht_time(&((component *)c)->core);
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    (void)kind, (void)value;
    return refuse(c, "there is no Integer status");
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (!c || !value || kind != fmi2Terminated) return refuse(c, "only fmi2Terminated is a Boolean status");
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    (void)kind, (void)value;
    return refuse(c, "there is no String status");
}
