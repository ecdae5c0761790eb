/* The FMI 3.0 face of the core: what these FMUs do not have, and therefore refuse. */
#include "fmi3_face.h"

static fmi3Status none(component *c, size_t n, const char *why) {
    if (!c) return fmi3Error;
    return n == 0 ? fmi3OK : ht3_refuse(c, why);
}

/* ---- variables of other types ---- */

#define OTHER_TYPE "all variables of this FMU are Float64"
#define NO_VARIABLES(type)                                                                                          \
    fmi3Status fmi3Get##type(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3##type v[], size_t nv) {  \
        (void)vr, (void)v;                                                                                          \
        return none(c, n + nv, OTHER_TYPE);                                                                         \
    }                                                                                                               \
    fmi3Status fmi3Set##type(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3##type v[],         \
                             size_t nv) {                                                                           \
        (void)vr, (void)v;                                                                                          \
        return none(c, n + nv, OTHER_TYPE);                                                                         \
    }

NO_VARIABLES(Float32)
NO_VARIABLES(Int8)
NO_VARIABLES(UInt8)
NO_VARIABLES(Int16)
NO_VARIABLES(UInt16)
NO_VARIABLES(Int32)
NO_VARIABLES(UInt32)
NO_VARIABLES(Int64)
NO_VARIABLES(UInt64)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)

fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, size_t sizes[], fmi3Binary v[], size_t nv) {
    (void)vr, (void)sizes, (void)v;
    return none(c, n + nv, OTHER_TYPE);
}

fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const size_t sizes[],
                         const fmi3Binary v[], size_t nv) {
    (void)vr, (void)sizes, (void)v;
    return none(c, n + nv, OTHER_TYPE);
}

/* ---- clocks ---- */

#define NO_CLOCKS "this FMU has no clocks"

fmi3Status fmi3GetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Clock v[]) {
    (void)vr, (void)v;
    return none(c, n, NO_CLOCKS);
}

fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Clock v[]) {
    (void)vr, (void)v;
    return none(c, n, NO_CLOCKS);
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 interval[],
                                  fmi3IntervalQualifier qualifier[]) {
    (void)vr, (void)interval, (void)qualifier;
    return none(c, n, NO_CLOCKS);
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counter[],
                                   fmi3UInt64 resolution[], fmi3IntervalQualifier qualifier[]) {
    (void)vr, (void)counter, (void)resolution, (void)qualifier;
    return none(c, n, NO_CLOCKS);
}

fmi3Status fmi3GetShiftDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 shift[]) {
    (void)vr, (void)shift;
    return none(c, n, NO_CLOCKS);
}

fmi3Status fmi3GetShiftFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counter[],
                                fmi3UInt64 resolution[]) {
    (void)vr, (void)counter, (void)resolution;
    return none(c, n, NO_CLOCKS);
}

fmi3Status fmi3SetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 interval[]) {
    (void)vr, (void)interval;
    return none(c, n, NO_CLOCKS);
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 counter[],
                                   const fmi3UInt64 resolution[]) {
    (void)vr, (void)counter, (void)resolution;
    return none(c, n, NO_CLOCKS);
}

fmi3Status fmi3SetShiftDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 shift[]) {
    (void)vr, (void)shift;
    return none(c, n, NO_CLOCKS);
}

fmi3Status fmi3SetShiftFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 counter[],
                                const fmi3UInt64 resolution[]) {
    (void)vr, (void)counter, (void)resolution;
    return none(c, n, NO_CLOCKS);
}

/* ---- dependencies of single elements: the description has them all ---- */

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference vr, size_t *n) {
    (void)vr, (void)n;
    return ht3_refuse(c, "dependencies are in the description alone (providesPerElementDependencies is false)");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference dependent, size_t elements[],
                                       fmi3ValueReference independents[], size_t independent_elements[],
                                       fmi3DependencyKind kinds[], size_t n) {
    (void)dependent, (void)elements, (void)independents, (void)independent_elements, (void)kinds, (void)n;
    return ht3_refuse(c, "dependencies are in the description alone (providesPerElementDependencies is false)");
}

/* ---- Scheduled Execution ---- */

fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time) {
    (void)clock, (void)time;
    return ht3_refuse(c, "this FMU does not offer Scheduled Execution");
}
