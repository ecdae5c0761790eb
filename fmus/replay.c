/* Replays an FMU on any machine and prints every output after every step.

     replay LIBRARY FMI KIND TOKEN STATES STEPS STEP INPUT SIZE OUTPUT...

   FMI is 2 or 3, KIND cs or me, INPUT and OUTPUT are value references; the input is SIZE times t (1 - t), held from step
   to step. Model Exchange is integrated by Runge-Kutta of order 4 in 40 parts of a step. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
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
#include "fmi3FunctionTypes.h"

#define PARTS 40
#define MOST 64

#define OF2(name) ((fmi2##name##TYPE *)symbol("fmi2" #name))
#define OF3(name) ((fmi3##name##TYPE *)symbol("fmi3" #name))

static int fmi, exchange, failed;
static void *fmu;

static void told2(fmi2ComponentEnvironment e, fmi2String name, fmi2Status s, fmi2String category, fmi2String text, ...) {
  (void)e, (void)name, (void)s, (void)category;
  fputs(text, stderr);
}

static void told3(fmi3InstanceEnvironment e, fmi3Status s, fmi3String category, fmi3String text) {
  (void)e, (void)s, (void)category;
  fputs(text, stderr);
}

static void begin2(const char *token) {
  static const fmi2CallbackFunctions callbacks = {told2, calloc, free, NULL, NULL};
  fmi2EventInfo info;
  fmu = OF2(Instantiate)("one", exchange ? fmi2ModelExchange : fmi2CoSimulation, token, "", &callbacks, 0, 0);
  if (!fmu) exit(1);
  failed |= OF2(SetupExperiment)(fmu, 0, 0.0, 0.0, 0, 0.0);
  failed |= OF2(EnterInitializationMode)(fmu) | OF2(ExitInitializationMode)(fmu);
  if (exchange) failed |= OF2(NewDiscreteStates)(fmu, &info) | OF2(EnterContinuousTimeMode)(fmu);
}

static void begin3(const char *token) {
  fmi3Boolean flags[5];
  fmi3Float64 next;
  fmu = exchange ? OF3(InstantiateModelExchange)("one", token, NULL, 0, 0, NULL, told3)
                 : OF3(InstantiateCoSimulation)("one", token, NULL, 0, 0, 0, 0, NULL, 0, NULL, told3, NULL);
  if (!fmu) exit(1);
  failed |= OF3(EnterInitializationMode)(fmu, 0, 0.0, 0.0, 0, 0.0) | OF3(ExitInitializationMode)(fmu);
  if (exchange) {
    failed |= OF3(UpdateDiscreteStates)(fmu, flags, flags + 1, flags + 2, flags + 3, flags + 4, &next);
    failed |= OF3(EnterContinuousTimeMode)(fmu);
  }
}

static void set(unsigned reference, double value) {
  failed |= fmi == 2 ? (int)OF2(SetReal)(fmu, &reference, 1, &value) : (int)OF3(SetFloat64)(fmu, &reference, 1, &value, 1);
}

static double get(unsigned reference) {
  double value = 0.0;
  failed |= fmi == 2 ? (int)OF2(GetReal)(fmu, &reference, 1, &value) : (int)OF3(GetFloat64)(fmu, &reference, 1, &value, 1);
  return value;
}

static void step(double t, double size) {
  fmi3Boolean event, end, early;
  fmi3Float64 last;
  if (fmi == 2) {
    failed |= OF2(DoStep)(fmu, t, size, 1);
  } else {
    failed |= OF3(DoStep)(fmu, t, size, 1, &event, &end, &early, &last);
  }
}

static void rates(double t, const double *x, double *rate, size_t n) {
  if (fmi == 2) {
    failed |= OF2(SetTime)(fmu, t) | OF2(SetContinuousStates)(fmu, x, n) | OF2(GetDerivatives)(fmu, rate, n);
  } else {
    failed |= OF3(SetTime)(fmu, t) | OF3(SetContinuousStates)(fmu, x, n);
    failed |= OF3(GetContinuousStateDerivatives)(fmu, rate, n);
  }
}

static void integrate(double t, double size, double *x, size_t n) {
  static const double at[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
  double h = size / PARTS, z[MOST], rate[MOST], sum[MOST];
  size_t i;
  int part, stage;
  for (part = 0; part < PARTS; part++, t += h) {
    memset(rate, 0, sizeof rate);
    memset(sum, 0, sizeof sum);
    for (stage = 0; stage < 4; stage++) {
      for (i = 0; i < n; i++) z[i] = x[i] + at[stage] * h * rate[i];
      rates(t + at[stage] * h, z, rate, n);
      for (i = 0; i < n; i++) sum[i] += weight[stage] * rate[i];
    }
    for (i = 0; i < n; i++) x[i] += h / 6.0 * sum[i];
  }
  rates(t, x, rate, n);
}

int main(int count, char **words) {
  double size, x[MOST];
  size_t n = 0;
  int i, k;
  if (count < 11 || !opened(words[1])) return 1;
  fmi = atoi(words[2]), exchange = strcmp(words[3], "me") == 0, size = atof(words[7]);
  if (fmi == 2) {
    begin2(words[4]);
  } else {
    begin3(words[4]);
  }
  if (exchange) {
    n = (size_t)atoi(words[5]);
    failed |= n > MOST || (fmi == 2 ? (int)OF2(GetContinuousStates)(fmu, x, n) : (int)OF3(GetContinuousStates)(fmu, x, n));
  }
  for (k = 0; k < atoi(words[6]) && !failed; k++) {
    double t = k * size;
    set((unsigned)atoi(words[8]), atof(words[9]) * t * (1.0 - t));
    if (exchange) {
      integrate(t, size, x, n);
    } else {
      step(t, size);
    }
    for (i = 10; i < count; i++) printf("%.17g\n", get((unsigned)atoi(words[i])));
  }
  if (fmi == 2) {
    OF2(FreeInstance)(fmu);
  } else {
    OF3(FreeInstance)(fmu);
  }
  return failed ? 2 : 0;
}
