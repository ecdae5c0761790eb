/* The FMI 2.0 face of the core, what both interfaces share. Translates phases, logging and memory; computes nothing. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2_face.h"

/* ---- logging and status: errors are always logged, warnings and discards unless they are switched off ---- */

static void say(component *c, fmi2Status status, const char *message) {
    int bit;
    const char *category = ht_category_of(status, &bit);
    if (c->callbacks.logger && ((c->logging | HT_LOG_ERROR) & bit))
        c->callbacks.logger(c->callbacks.componentEnvironment, c->name, status, category, "%s", message);
}

fmi2Status ht2_answer(component *c, ht_status status) {
    fmi2Status out = status == HT_OK ? fmi2OK : status == HT_DISCARD ? fmi2Discard : fmi2Error;
    if (out != fmi2OK) say(c, out, c->core.message);
    return out;
}

void ht2_tell_domain(component *c) {
    if (c->core.left_domain) say(c, fmi2Warning, c->core.message);
}

fmi2Status ht2_refuse(component *c, const char *why) {
    if (c) say(c, fmi2Error, why);
    return fmi2Error;
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    int wanted;
    if (!c || (n > 0 && !categories)) return fmi2Error;
    wanted = ht_categories_on(on, n, categories);
    if (wanted < 0) return ht2_refuse(c, "there is no such log category");
    ((component *)c)->logging = wanted;
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
    ht_interface interface;
    (void)resources, (void)visible;
    if (!functions) return NULL;
    memset(&early, 0, sizeof early);
    early.callbacks = *functions;
    early.name = (char *)(name ? name : "");
    if (!name || !*name) return ht2_refuse(&early, "an instance needs a name"), NULL;
    if (!guid || strcmp(guid, model->guid) != 0) return ht2_refuse(&early, "the GUID is not the one of this FMU"), NULL;
    interface = type == fmi2ModelExchange ? HT_MODEL_EXCHANGE : HT_CO_SIMULATION;
    if (!(model->interfaces & (int)interface))
        return ht2_refuse(&early, "this FMU does not offer the interface that is asked for"), NULL;
    length = strlen(name) + 1;
    memory = functions->allocateMemory ? functions->allocateMemory(1, own + ht_bytes(model) + length)
                                       : calloc(1, own + ht_bytes(model) + length);
    if (!memory) return ht2_refuse(&early, "out of memory"), NULL;
    memset(memory, 0, own + ht_bytes(model) + length);
    c = (component *)memory;
    c->callbacks = *functions;
    c->logging = logging ? HT_LOG_ALL : HT_LOG_WARNING | HT_LOG_DISCARD;
    c->name = memory + own + ht_bytes(model);
    memcpy(c->name, name, length);
    ht_place(&c->core, model, interface, memory + own);
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
    return c ? ht2_answer(c, ht_setup(&((component *)c)->core, start, stop_defined, stop)) : fmi2Error;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    return c ? ht2_answer(c, ht_enter_initialisation(&((component *)c)->core)) : fmi2Error;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    fmi2Status status = c ? ht2_answer(c, ht_exit_initialisation(&((component *)c)->core)) : fmi2Error;
    if (status == fmi2OK) say(c, fmi2OK, "the initial states are computed");
    return status;
}

fmi2Status fmi2Terminate(fmi2Component c) { return c ? ht2_answer(c, ht_terminate(&((component *)c)->core)) : fmi2Error; }

fmi2Status fmi2Reset(fmi2Component c) {
    if (!c) return fmi2Error;
    ht_reset(&((component *)c)->core);
    return fmi2OK;
}

/* ---- variables: all are Real ---- */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    if (!c || (n > 0 && (!vr || !value))) return fmi2Error;
    return ht2_answer(c, ht_get(&((component *)c)->core, vr, n, value));
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    if (!c || (n > 0 && (!vr || !value))) return fmi2Error;
    return ht2_answer(c, ht_set(&((component *)c)->core, vr, n, value));
}

static fmi2Status none_of_type(component *c, size_t n, const char *type) {
    char text[80];
    if (!c) return fmi2Error;
    if (n == 0) return fmi2OK;
    sprintf(text, "this FMU has no variables of type %.16s", type);
    return ht2_refuse(c, text);
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
    if (!c || !state) return fmi2Error;
    core = &((component *)c)->core;
    if (!*state) *state = malloc(ht_state_bytes(core->model));
    if (!*state) return ht2_refuse(c, "out of memory");
    ht_save(core, *state);
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    return c && state ? ht2_answer(c, ht_load(&((component *)c)->core, state)) : fmi2Error;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (!c) return fmi2Error;
    if (state && *state) {
        free(*state);
        *state = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    if (!c || !state || !size) return fmi2Error;
    *size = ht_serialized_bytes(((component *)c)->core.model);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    return c && state && bytes ? ht2_answer(c, ht_serialize(&((component *)c)->core, state, bytes, size)) : fmi2Error;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    ht_instance *core;
    if (!c || !state || !bytes) return fmi2Error;
    core = &((component *)c)->core;
    if (ht_check_serialized(core, bytes, size) != HT_OK) return ht2_answer(c, HT_ERROR);
    if (!*state) *state = malloc(ht_state_bytes(core->model));
    if (!*state) return ht2_refuse(c, "out of memory");
    ht_deserialize(core, bytes, *state);
    return fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t unknowns,
                                        const fmi2ValueReference known[], size_t knowns, const fmi2Real seed[],
                                        fmi2Real sensitivity[]) {
    if (!c || (unknowns > 0 && (!unknown || !sensitivity)) || (knowns > 0 && (!known || !seed))) return fmi2Error;
    return ht2_answer(c, ht_directional(&((component *)c)->core, unknown, unknowns, known, knowns, seed, sensitivity));
}
