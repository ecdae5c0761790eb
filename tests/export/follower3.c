/* The face of FMI 3.0, as far as masters call it; follower.py adds the rest, which answers with an error. */
#ifdef __clang__
#pragma clang diagnostic ignored "-Wstrict-prototypes"
#endif
#include "fmi3Functions.h"
#include "follower.h"

#define P ((plant *)c)

static void *made(void) {
    plant *p = malloc(sizeof *p);
    if (p) begin(p);
    return p;
}

const char *fmi3GetVersion(void) { return fmi3Version; }
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t n, fmi3InstanceEnvironment e,
                                         fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    return made();
}
fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment e, fmi3LogMessageCallback log) {
    return made();
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String names[]) {
    return fmi3OK;
}
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean t, fmi3Float64 tolerance, fmi3Float64 start,
                                       fmi3Boolean s, fmi3Float64 stop) {
    P->time = start;
    return fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) {
    P->initialising = P->written = P->disturbed = 0;
    P->taken = P->u;
    return fmi3OK;
}
fmi3Status fmi3Terminate(fmi3Instance c) { return c ? fmi3OK : fmi3Error; }
fmi3Status fmi3Reset(fmi3Instance c) {
    begin(P);
    return fmi3OK;
}

#define EACH(line)              \
    size_t k;                   \
    for (k = 0; k < n; k++) {   \
        line;                   \
    }                           \
    return fmi3OK
#define REFERENCES fmi3Instance c, const fmi3ValueReference r[], size_t n

fmi3Status fmi3GetFloat64(REFERENCES, fmi3Float64 v[], size_t m) { EACH(v[k] = get_real(P, r[k])); }
fmi3Status fmi3SetFloat64(REFERENCES, const fmi3Float64 v[], size_t m) { EACH(set_real(P, r[k], v[k])); }
fmi3Status fmi3GetInt32(REFERENCES, fmi3Int32 v[], size_t m) { EACH(v[k] = get_whole(P, r[k])); }
fmi3Status fmi3SetInt32(REFERENCES, const fmi3Int32 v[], size_t m) { EACH(set_whole(P, r[k], v[k])); }
fmi3Status fmi3GetBoolean(REFERENCES, fmi3Boolean v[], size_t m) { EACH(v[k] = get_whole(P, r[k]) != 0); }
fmi3Status fmi3SetBoolean(REFERENCES, const fmi3Boolean v[], size_t m) { EACH(set_whole(P, r[k], v[k] != 0)); }
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 size, fmi3Boolean no_return, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last) {
    walk(P, size);
    *last = P->time = time + size;
    *event = *terminate = *early = fmi3False;
    return fmi3OK;
}

fmi3Status fmi3EnterEventMode(fmi3Instance c) { return c ? fmi3OK : fmi3Error; }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *planned, fmi3Float64 *next) {
    *again = *terminate = *nominals = *values = *planned = fmi3False;
    *next = 0.0;
    P->taken = P->u;
    return fmi3OK;
}
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { return c ? fmi3OK : fmi3Error; }
fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no_return, fmi3Boolean *event, fmi3Boolean *terminate) {
    *event = *terminate = fmi3False;
    return fmi3OK;
}
fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) {
    P->time = time;
    P->known = 0;
    return fmi3OK;
}
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) {
    if (n) P->x = x[0];
    return fmi3OK;
}
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 dx[], size_t n) {
    if (n) dx[0] = rate(P);
    return fmi3OK;
}
fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    if (n) x[0] = P->x;
    return fmi3OK;
}
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    if (n) x[0] = 1.0;
    return fmi3OK;
}
fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 z[], size_t n) {
    return n ? fmi3Error : fmi3OK;
}
