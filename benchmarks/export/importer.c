/* The smallest importer of a Co-Simulation FMU of FMI 2.0 in C: set the input, step, get the outputs.

     importer LIBRARY GUID DRIVE FOUND ROUNDS SAMPLES STEP INPUT START VALUE OUTPUT...

   INPUT, START and OUTPUT are value references; DRIVE holds SAMPLES doubles, FOUND gets the outputs after each step.
   Prints the CPU seconds of the fastest round, of the steps alone. */

#define _POSIX_C_SOURCE 200809L
#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "fmi2FunctionTypes.h"

#define OUTPUTS 64

static void *library;

static void *symbol(const char *name) {
  void *found = dlsym(library, name);
  if (!found) {
    fprintf(stderr, "no %s in the library\n", name);
    exit(1);
  }
  return found;
}

static void checked(fmi2Status status, const char *what) {
  if (status != fmi2OK) {
    fprintf(stderr, "%s answered %d\n", what, (int)status);
    exit(1);
  }
}

static void told(fmi2ComponentEnvironment e, fmi2String name, fmi2Status s, fmi2String category, fmi2String text, ...) {
  va_list values;
  (void)e, (void)name, (void)s, (void)category;
  va_start(values, text);
  vfprintf(stderr, text, values);
  va_end(values);
}

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

int main(int count, char **words) {
  const fmi2CallbackFunctions callbacks = {told, calloc, free, NULL, NULL};
  const int rounds = count > 11 ? atoi(words[5]) : 0, outputs = count - 11;
  const long samples = rounds ? atol(words[6]) : 0;
  fmi2ValueReference input, start, output[OUTPUTS];
  double *drive = calloc((size_t)samples + 1, sizeof(double)), *found, step, value, best = 1e300;
  FILE *file;
  long k;
  int i, r;
  if (!rounds || outputs > OUTPUTS || !(library = dlopen(words[1], RTLD_NOW | RTLD_LOCAL))) {
    fprintf(stderr, "usage as in the comment on top; %s\n", rounds ? dlerror() : "too few words");
    return 1;
  }
  fmi2InstantiateTYPE *instantiate;
  fmi2FreeInstanceTYPE *release;
  fmi2SetupExperimentTYPE *setup;
  fmi2EnterInitializationModeTYPE *enter;
  fmi2ExitInitializationModeTYPE *leave;
  fmi2SetRealTYPE *set;
  fmi2GetRealTYPE *get;
  fmi2DoStepTYPE *advance;
  *(void **)&instantiate = symbol("fmi2Instantiate");
  *(void **)&release = symbol("fmi2FreeInstance");
  *(void **)&setup = symbol("fmi2SetupExperiment");
  *(void **)&enter = symbol("fmi2EnterInitializationMode");
  *(void **)&leave = symbol("fmi2ExitInitializationMode");
  *(void **)&set = symbol("fmi2SetReal");
  *(void **)&get = symbol("fmi2GetReal");
  *(void **)&advance = symbol("fmi2DoStep");
  step = atof(words[7]), input = (fmi2ValueReference)atol(words[8]);
  start = (fmi2ValueReference)atol(words[9]), value = atof(words[10]);
  for (i = 0; i < outputs; i++) output[i] = (fmi2ValueReference)atol(words[11 + i]);
  found = calloc((size_t)(samples * outputs), sizeof(double));
  if (!(file = fopen(words[3], "rb")) || fread(drive, sizeof(double), (size_t)samples, file) != (size_t)samples) return 1;
  fclose(file);
  for (r = 0; r < rounds; r++) {
    fmi2Component fmu = instantiate("one", fmi2CoSimulation, words[2], "", &callbacks, fmi2False, fmi2False);
    double begun, spent;
    if (!fmu) return 1;
    checked(setup(fmu, fmi2False, 0.0, 0.0, fmi2False, 0.0), "fmi2SetupExperiment");
    checked(set(fmu, &start, 1, &value), "fmi2SetReal of the start");
    checked(enter(fmu), "fmi2EnterInitializationMode");
    checked(set(fmu, &input, 1, drive), "fmi2SetReal of the input");
    checked(leave(fmu), "fmi2ExitInitializationMode");
    begun = now();
    for (k = 0; k < samples; k++) {
      checked(set(fmu, &input, 1, drive + k), "fmi2SetReal");
      checked(advance(fmu, (double)k * step, step, fmi2True), "fmi2DoStep");
      checked(get(fmu, output, (size_t)outputs, found + k * outputs), "fmi2GetReal");
    }
    spent = now() - begun;
    best = spent < best ? spent : best;
    release(fmu);
  }
  if (!(file = fopen(words[4], "wb"))) return 1;
  fwrite(found, sizeof(double), (size_t)(samples * outputs), file);
  fclose(file);
  printf("%.9f\n", best);
  return 0;
}
