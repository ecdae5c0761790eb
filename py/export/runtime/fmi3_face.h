/* Shared by the files of the FMI 3.0 face: what lies behind an fmi3Instance. */
#ifndef FMI3_FACE_H
#define FMI3_FACE_H

#include "categories.h"
#include "core.h"

#ifdef __clang__ /* the header of the standard declares two functions without a prototype */
#pragma clang diagnostic push
#pragma clang diagnostic ignored "-Wstrict-prototypes"
#endif
#include "fmi3Functions.h"
#ifdef __clang__
#pragma clang diagnostic pop
#endif

typedef struct {
    ht_instance core;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    int logging;                           /* the categories that are on */
    fmi3IntermediateUpdateCallback update; /* or NULL */
    fmi3Boolean early_return;              /* whether the importer can handle it */
    char *name;
} component;

fmi3Status ht3_answer(component *c, ht_status status); /* log what went wrong, translate */
fmi3Status ht3_refuse(component *c, const char *why);  /* log, fmi3Error; c may be NULL */
void ht3_tell_domain(component *c);                    /* warn of a block that has left its training data */
double ht3_watch(ht_instance *core, double end);       /* the watcher of Co-Simulation: calls intermediateUpdate */

#endif
