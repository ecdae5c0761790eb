/* Shared by the files of the FMI 2.0 face: what lies behind an fmi2Component. */
#ifndef FMI2_FACE_H
#define FMI2_FACE_H

#include "categories.h"
#include "core.h"
#include "fmi2Functions.h"

typedef struct {
    ht_instance core;
    fmi2CallbackFunctions callbacks;
    int logging; /* the categories that are on */
    char *name;
} component;

fmi2Status ht2_answer(component *c, ht_status status); /* log what went wrong, translate */
fmi2Status ht2_refuse(component *c, const char *why);  /* log, fmi2Error; c may be NULL */
void ht2_tell_domain(component *c);                    /* warn of a block that has left its training data */

#endif
