/* What model.inc tells of the FMUs inside this one, and what an instance knows of its own instances of them. */
#include <stdbool.h>
#include <stdlib.h>

enum { RF_DOUBLE, RF_FLOAT, RF_I8, RF_U8, RF_I16, RF_U16, RF_I32, RF_U32, RF_I64, RF_U64, RF_BOOL, RF_TEXT };

/* A variable that is set before the initialisation where one of its n values is not its start value, or always: type in
 * memory, word in the name of the function that sets it, where its values are among [parameters; inputs; constants], of a
 * text its place among the texts. */
typedef struct {
  int type;
  const char *word;
  uint32_t reference;
  int n, at, always;
} rf_setting;

/* counts: of value references of inputs and outputs, which with arrays are fewer than the values. scales (n, 2): SI =
 * factor value + offset. starts, known: SI, of [parameters; inputs]; idle: inputs where none are given; constants: as they
 * are set. at_x: place of its states. step: of one for Co-Simulation [s], else 0. */
typedef struct {
  const char *block, *library, *resources, *token;
  double step;
  int version, reports, at_x, at_z, n_x, n_u, n_y, n_z, n_p, counts[2], n_settings, n_constants, n_categories, largest;
  const uint32_t *u_refs, *y_refs;
  const double *u_scales, *y_scales, *starts, *idle, *scales, *constants;
  const rf_setting *settings;
  const char *const *texts, *const *categories;
} rf_model;

enum { RF_AT_POINT, RF_AT_BEGIN, RF_BY_STEPS };

/* A function that the generated code calls: of which FMU, whether it gives what it has at a point, where it begins, or
 * behind a step; rows of [x'; y], and whether t, x, u, p are arguments. */
typedef struct {
  int inner, what, n_rows, at_row, groups[4];
} rf_called;

typedef struct { /* fmi2CallbackFunctions */
  void (*logger)(void *, const char *, int, const char *, const char *, ...);
  void *(*allocate)(size_t, size_t);
  void (*release)(void *);
  void (*finished)(void *, int);
  void *environment;
} rf_callbacks;

/* An instance of an FMU inside, with parameters p as it was begun: x, its states after the last event, values that are set.
 * made: how many there have been; fresh: instantiated and no more; begun: past its initialisation; states, nominals:
 * whether the last event has changed them; time: of what it was asked last; since: when it has begun; steps: since
 * then. */
typedef struct {
  rs_fmu fmu;
  rs_instance at;
  const rf_model *model;
  struct rf_instance *outer;
  void *library;
  char *name, *resources;
  double *memory, *p, *x, *zeros, *out, *values;
  void *buffer;
  int made, fresh, begun, states, nominals;
  double time, since, steps;
  rf_callbacks callbacks;
} rf_inner;

/* Where events were last: sides (+-1) of all event indicators, when each has crossed zero last from its upper and lower
 * side, the time of the last event, whether an indicator is exactly zero behind it. */
typedef struct {
  double sides[RF_NESTED_Z + 1], last[2 * RF_NESTED_Z + 1], clock;
  int touching, begun, count;
} rf_switching;
