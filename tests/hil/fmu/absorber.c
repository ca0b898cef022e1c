/* A mass on a spring, shaken at its own frequency, with a tuned absorber on it: FMI 2.0, model
 * exchange and co-simulation. The input is the absorber's frequency in units of the mass's.
 *
 *     x1'' = -w^2 x1 - 2 z1 w x1' + m (wa^2 (x2 - x1) + 2 z2 wa (x2' - x1')) + f sin(w t)
 *     x2'' = -wa^2 (x2 - x1) - 2 z2 wa (x2' - x1'),   wa = tuning w
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define EXPORT __attribute__((visibility("default")))
#define W 6.283185307179586
#define Z1 0.01
#define Z2 0.03
#define M 0.05
#define H 0.002 /* [s] of a step of the co-simulation, at most */
#define STATES 4
enum { X1, V1, X2, V2, A1, A2, TUNING, FORCE, VALUES };
enum { OK = 0, DISCARD = 2, ERROR = 3 };

typedef struct { double value[VALUES], time; } Model;
typedef struct { int newDiscreteStatesNeeded, terminateSimulation, nominals, values, timeDefined;
                 double nextEventTime; } EventInfo;
typedef const unsigned *References;

static void derive(Model *m) {
  double *v = m->value, wa = v[TUNING] * W;
  double pull = wa * wa * (v[X2] - v[X1]) + 2 * Z2 * wa * (v[V2] - v[V1]);
  v[A1] = -W * W * v[X1] - 2 * Z1 * W * v[V1] + M * pull + v[FORCE] * sin(W * m->time);
  v[A2] = -pull;
}

static void slope(Model *m, const double *x, double t, double *found) {
  memcpy(m->value, x, STATES * sizeof(double));
  m->time = t;
  derive(m);
  found[X1] = x[V1], found[V1] = m->value[A1], found[X2] = x[V2], found[V2] = m->value[A2];
}

static void advance(Model *m, double h) { /* the classical Runge-Kutta method */
  static const double at[4] = {0, 0.5, 0.5, 1}, weight[4] = {1. / 6, 1. / 3, 1. / 3, 1. / 6};
  double begin[STATES], x[STATES], k[STATES] = {0}, sum[STATES] = {0}, t = m->time;
  memcpy(begin, m->value, sizeof begin);
  for (int s = 0; s < 4; s++) {
    for (int i = 0; i < STATES; i++) x[i] = begin[i] + at[s] * h * k[i];
    slope(m, x, t + at[s] * h, k);
    for (int i = 0; i < STATES; i++) sum[i] += weight[s] * k[i];
  }
  for (int i = 0; i < STATES; i++) m->value[i] = begin[i] + h * sum[i];
  m->time = t + h;
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT int fmi2Reset(void *c) {
  Model *m = c;
  memset(m, 0, sizeof *m);
  m->value[TUNING] = m->value[FORCE] = 1;
  return OK;
}
EXPORT void *fmi2Instantiate(const char *name, int kind, const char *guid, const char *resources,
                             const void *callbacks, int visible, int logging) {
  Model *m = malloc(sizeof *m);
  if (m) fmi2Reset(m);
  return m;
}
EXPORT void fmi2FreeInstance(void *c) { free(c); }
EXPORT int fmi2SetupExperiment(void *c, int given, double tolerance, double begin, int ends, double end) {
  ((Model *)c)->time = begin;
  return OK;
}
EXPORT int fmi2GetReal(void *c, References vr, size_t n, double *value) {
  derive(c);
  for (size_t i = 0; i < n; i++) {
    if (vr[i] >= VALUES) return ERROR;
    value[i] = ((Model *)c)->value[vr[i]];
  }
  return OK;
}
EXPORT int fmi2SetReal(void *c, References vr, size_t n, const double *value) {
  for (size_t i = 0; i < n; i++) {
    if (vr[i] >= VALUES) return ERROR;
    ((Model *)c)->value[vr[i]] = value[i];
  }
  return OK;
}

/* model exchange */
EXPORT int fmi2SetTime(void *c, double time) { ((Model *)c)->time = time; return OK; }
EXPORT int fmi2SetContinuousStates(void *c, const double *x, size_t n) {
  memcpy(((Model *)c)->value, x, n * sizeof *x);
  return OK;
}
EXPORT int fmi2GetContinuousStates(void *c, double *x, size_t n) {
  memcpy(x, ((Model *)c)->value, n * sizeof *x);
  return OK;
}
EXPORT int fmi2GetDerivatives(void *c, double *dx, size_t n) {
  double *v = ((Model *)c)->value;
  derive(c);
  dx[X1] = v[V1], dx[V1] = v[A1], dx[X2] = v[V2], dx[V2] = v[A2];
  return OK;
}
EXPORT int fmi2GetNominalsOfContinuousStates(void *c, double *x, size_t n) {
  for (size_t i = 0; i < n; i++) x[i] = 1;
  return OK;
}
EXPORT int fmi2NewDiscreteStates(void *c, EventInfo *info) {
  memset(info, 0, sizeof *info);
  return OK;
}
EXPORT int fmi2CompletedIntegratorStep(void *c, int keeps, int *event, int *ends) {
  *event = *ends = 0;
  return OK;
}

/* co-simulation */
EXPORT int fmi2DoStep(void *c, double time, double size, int keeps) {
  int steps = (int)ceil(size / H - 1e-9);
  ((Model *)c)->time = time;
  for (int i = 0; i < steps; i++) advance(c, size / steps);
  ((Model *)c)->time = time + size;
  return OK;
}

/* nothing to do, and what it cannot do */
#define EMPTY(name) EXPORT int name(void *c) { return OK; }
#define NONE(name) EXPORT int name(void *c) { return ERROR; }
EMPTY(fmi2EnterInitializationMode) EMPTY(fmi2ExitInitializationMode) EMPTY(fmi2Terminate)
EMPTY(fmi2EnterEventMode) EMPTY(fmi2EnterContinuousTimeMode) EMPTY(fmi2SetDebugLogging)
EMPTY(fmi2GetEventIndicators)
NONE(fmi2GetInteger) NONE(fmi2SetInteger) NONE(fmi2GetBoolean) NONE(fmi2SetBoolean)
NONE(fmi2GetString) NONE(fmi2SetString) NONE(fmi2GetFMUstate) NONE(fmi2SetFMUstate)
NONE(fmi2FreeFMUstate) NONE(fmi2SerializedFMUstateSize) NONE(fmi2SerializeFMUstate)
NONE(fmi2DeSerializeFMUstate) NONE(fmi2GetDirectionalDerivative) NONE(fmi2SetRealInputDerivatives)
NONE(fmi2GetRealOutputDerivatives) NONE(fmi2CancelStep) NONE(fmi2GetStatus) NONE(fmi2GetRealStatus)
NONE(fmi2GetIntegerStatus) NONE(fmi2GetBooleanStatus) NONE(fmi2GetStringStatus)
