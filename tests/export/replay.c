/* Replays a Co-Simulation FMU of FMI 2.0 on any machine and prints every output after every step.

     replay LIBRARY GUID STEPS STEP INPUT OUTPUT...          (INPUT and OUTPUT are value references)

   The input is 0.3 t (1 - t), held from step to step. */
#include <stdio.h>
#include <stdlib.h>
#ifdef _WIN32
#include <windows.h>
static HMODULE library;
static int opened(const char *path) { return (library = LoadLibraryA(path)) != NULL; }
static void *symbol(const char *name) { return (void *)GetProcAddress(library, name); }
#else
#include <dlfcn.h>
static void *library;
static int opened(const char *path) { return (library = dlopen(path, RTLD_NOW)) != NULL; }
static void *symbol(const char *name) { return dlsym(library, name); }
#endif
#include "fmi2FunctionTypes.h"

static void told(fmi2ComponentEnvironment e, fmi2String name, fmi2Status s, fmi2String category, fmi2String text, ...) {
  (void)e, (void)name, (void)s, (void)category;
  fputs(text, stderr);
}

int main(int count, char **words) {
  const fmi2CallbackFunctions callbacks = {told, calloc, free, NULL, NULL};
  fmi2ValueReference input, output;
  fmi2Component fmu;
  double step, value;
  int i, k, failed = 0;
  if (count < 7 || !opened(words[1])) return 1;
  fmi2InstantiateTYPE *instantiate = (fmi2InstantiateTYPE *)symbol("fmi2Instantiate");
  fmi2SetupExperimentTYPE *setup = (fmi2SetupExperimentTYPE *)symbol("fmi2SetupExperiment");
  fmi2EnterInitializationModeTYPE *enter = (fmi2EnterInitializationModeTYPE *)symbol("fmi2EnterInitializationMode");
  fmi2ExitInitializationModeTYPE *leave = (fmi2ExitInitializationModeTYPE *)symbol("fmi2ExitInitializationMode");
  fmi2SetRealTYPE *set = (fmi2SetRealTYPE *)symbol("fmi2SetReal");
  fmi2GetRealTYPE *get = (fmi2GetRealTYPE *)symbol("fmi2GetReal");
  fmi2DoStepTYPE *advance = (fmi2DoStepTYPE *)symbol("fmi2DoStep");
  fmi2FreeInstanceTYPE *release = (fmi2FreeInstanceTYPE *)symbol("fmi2FreeInstance");
  step = atof(words[4]), input = (fmi2ValueReference)atol(words[5]);
  if (!(fmu = instantiate("one", fmi2CoSimulation, words[2], "", &callbacks, fmi2False, fmi2False))) return 1;
  failed |= setup(fmu, fmi2False, 0.0, 0.0, fmi2False, 0.0) | enter(fmu) | leave(fmu);
  for (k = 0; k < atoi(words[3]); k++) {
    double t = k * step, u = 0.3 * t * (1 - t);
    failed |= set(fmu, &input, 1, &u) | advance(fmu, t, step, fmi2True);
    for (i = 6; i < count; i++) {
      output = (fmi2ValueReference)atol(words[i]);
      failed |= get(fmu, &output, 1, &value);
      printf("%.17g\n", value);
    }
  }
  release(fmu);
  return failed ? 2 : 0;
}
