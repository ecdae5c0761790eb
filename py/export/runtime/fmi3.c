/* The FMI 3.0 face of the core, what all interfaces share. Translates phases, logging and memory; computes nothing. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3_face.h"

static ht_instance *core_of(fmi3Instance c) { return &((component *)c)->core; }

/* ---- logging and status: errors are always logged, the rest when logging is on ---- */

static void say(component *c, fmi3Status status, const char *message) {
    int bit;
    const char *category = ht_category_of(status, &bit);
    if (c->log && ((c->logging | HT_LOG_ERROR) & bit)) c->log(c->environment, status, category, message);
}

fmi3Status ht3_answer(component *c, ht_status status) {
    fmi3Status out = status == HT_OK ? fmi3OK : status == HT_DISCARD ? fmi3Discard : fmi3Error;
    if (out != fmi3OK) say(c, out, c->core.message);
    return out;
}

void ht3_tell_domain(component *c) {
    if (c->core.left_domain) say(c, fmi3Warning, c->core.message);
}

fmi3Status ht3_refuse(component *c, const char *why) {
    if (c) say(c, fmi3Error, why);
    return fmi3Error;
}

/* Inside a communication step the instance can neither go nor be reset, saved or replaced. */
static int busy(component *c) {
    if (ht_phase_of(&c->core) != HT_BETWEEN) return 0;
    ht3_refuse(c, "this is not allowed in intermediate update mode");
    return 1;
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    int wanted;
    if (!c || (n > 0 && !categories)) return fmi3Error;
    wanted = ht_categories_on(on, n, categories);
    if (wanted < 0) return ht3_refuse(c, "there is no such log category");
    ((component *)c)->logging = wanted;
    return fmi3OK;
}

/* ---- life ---- */

static fmi3Instance instantiate(ht_interface interface, fmi3String name, fmi3String token, fmi3Boolean logging,
                                fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    const ht_model *model = &ht_the_model;
    size_t own = (sizeof(component) + 15) / 16 * 16, length;
    char *memory;
    component *c, early;
    memset(&early, 0, sizeof early);
    early.environment = environment;
    early.log = log;
    if (!name || !*name) return ht3_refuse(&early, "an instance needs a name"), NULL;
    if (!token || strcmp(token, model->guid) != 0)
        return ht3_refuse(&early, "the instantiation token is not the one of this FMU"), NULL;
    if (!(model->interfaces & (int)interface))
        return ht3_refuse(&early, "this FMU does not offer the interface that is asked for"), NULL;
    length = strlen(name) + 1;
    memory = calloc(1, own + ht_bytes(model) + length);
    if (!memory) return ht3_refuse(&early, "out of memory"), NULL;
    c = (component *)memory;
    c->environment = environment;
    c->log = log;
    c->logging = logging ? HT_LOG_ALL : 0;
    c->name = memory + own + ht_bytes(model);
    memcpy(c->name, name, length);
    ht_place(&c->core, model, interface, memory + own);
    return c;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log) {
    (void)resources, (void)visible;
    return instantiate(HT_MODEL_EXCHANGE, name, token, logging, environment, log);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference intermediate[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    component early, *c;
    size_t k;
    (void)resources, (void)visible;
    memset(&early, 0, sizeof early);
    early.environment = environment;
    early.log = log;
    if (event_mode) return ht3_refuse(&early, "this FMU has no event mode in Co-Simulation (hasEventMode is false)"), NULL;
    if (n > 0 && (!update || !intermediate))
        return ht3_refuse(&early, "intermediate variables need their list and an intermediateUpdate callback"), NULL;
    for (k = 0; k < n; k++)
        if (!ht_between(&ht_the_model, intermediate[k]))
            return ht3_refuse(&early, "a required intermediate variable is not one (intermediateUpdate is false)"), NULL;
    c = instantiate(HT_CO_SIMULATION, name, token, logging, environment, log);
    if (!c) return NULL;
    c->update = update;
    c->early_return = early_return;
    c->core.watcher = update ? ht3_watch : NULL;
    return c;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock) {
    component early;
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)update, (void)lock, (void)unlock;
    memset(&early, 0, sizeof early);
    early.environment = environment;
    early.log = log;
    return ht3_refuse(&early, "this FMU does not offer Scheduled Execution"), NULL;
}

void fmi3FreeInstance(fmi3Instance c) {
    if (c && busy(c)) return; /* doStep will still need it */
    free(c);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop) {
    ht_status status;
    (void)tolerance_defined, (void)tolerance;
    if (!c) return fmi3Error;
    status = ht_setup(core_of(c), start, stop_defined, stop);
    return ht3_answer(c, status == HT_OK ? ht_enter_initialisation(core_of(c)) : status);
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) {
    fmi3Status status = c ? ht3_answer(c, ht_exit_initialisation(core_of(c))) : fmi3Error;
    if (status == fmi3OK) say(c, fmi3OK, "the initial states are computed");
    return status;
}

fmi3Status fmi3EnterEventMode(fmi3Instance c) { return c ? ht3_answer(c, ht_enter_event(core_of(c))) : fmi3Error; }

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *needed, fmi3Boolean *terminate, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *next_defined, fmi3Float64 *next) {
    if (!c || !needed || !terminate || !nominals || !values || !next_defined || !next) return fmi3Error;
    *needed = *terminate = *nominals = *values = *next_defined = fmi3False;
    *next = 0.0;
    return ht3_answer(c, ht_discrete_update(core_of(c)));
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c) {
    return ht3_refuse(c, "discrete states are not evaluated apart (providesEvaluateDiscreteStates is false)");
}

fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { return ht3_refuse(c, "there are no structural parameters"); }

fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { return ht3_refuse(c, "there are no structural parameters"); }

fmi3Status fmi3Terminate(fmi3Instance c) { return c ? ht3_answer(c, ht_terminate(core_of(c))) : fmi3Error; }

fmi3Status fmi3Reset(fmi3Instance c) {
    if (!c || busy(c)) return fmi3Error;
    ht_reset(core_of(c));
    return fmi3OK;
}

/* ---- variables: all are Float64 ---- */

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[], size_t values) {
    if (!c || (n > 0 && (!vr || !value))) return fmi3Error;
    if (values != n) return ht3_refuse(c, "each variable has one value");
    return ht3_answer(c, ht_get(core_of(c), vr, n, value));
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[], size_t values) {
    if (!c || (n > 0 && (!vr || !value))) return fmi3Error;
    if (values != n) return ht3_refuse(c, "each variable has one value");
    return ht3_answer(c, ht_set(core_of(c), vr, n, value));
}

/* ---- the whole state ---- */

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) {
    if (!c || !state || busy(c)) return fmi3Error;
    if (!*state) *state = malloc(ht_state_bytes(core_of(c)->model));
    if (!*state) return ht3_refuse(c, "out of memory");
    ht_save(core_of(c), *state);
    return fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) {
    return c && state ? ht3_answer(c, ht_load(core_of(c), state)) : fmi3Error;
}

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state) {
    if (!c) return fmi3Error;
    if (state && *state) {
        free(*state);
        *state = NULL;
    }
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size) {
    if (!c || !state || !size) return fmi3Error;
    *size = ht_serialized_bytes(core_of(c)->model);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    return c && state && bytes ? ht3_answer(c, ht_serialize(core_of(c), state, bytes, size)) : fmi3Error;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
    if (!c || !state || !bytes) return fmi3Error;
    if (ht_check_serialized(core_of(c), bytes, size) != HT_OK) return ht3_answer(c, HT_ERROR);
    if (!*state) *state = malloc(ht_state_bytes(core_of(c)->model));
    if (!*state) return ht3_refuse(c, "out of memory");
    ht_deserialize(core_of(c), bytes, *state);
    return fmi3OK;
}

/* ---- derivatives ---- */

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknown[], size_t unknowns,
                                        const fmi3ValueReference known[], size_t knowns, const fmi3Float64 seed[],
                                        size_t seeds, fmi3Float64 sensitivity[], size_t sensitivities) {
    if (!c || (unknowns > 0 && (!unknown || !sensitivity)) || (knowns > 0 && (!known || !seed))) return fmi3Error;
    if (seeds != knowns || sensitivities != unknowns) return ht3_refuse(c, "each variable has one value");
    return ht3_answer(c, ht_directional(core_of(c), unknown, unknowns, known, knowns, seed, sensitivity));
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknown[], size_t unknowns,
                                    const fmi3ValueReference known[], size_t knowns, const fmi3Float64 seed[],
                                    size_t seeds, fmi3Float64 sensitivity[], size_t sensitivities) {
    if (!c || (unknowns > 0 && (!unknown || !seed)) || (knowns > 0 && (!known || !sensitivity))) return fmi3Error;
    if (seeds != unknowns || sensitivities != knowns) return ht3_refuse(c, "each variable has one value");
    return ht3_answer(c, ht_adjoint(core_of(c), unknown, unknowns, known, knowns, seed, sensitivity));
}
