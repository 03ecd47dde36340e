/* FMUs inside this one: loaded from its resources, begun, and asked by the generated code for their equations, or stepped
 * from hit to hit of the diagram. It is a part of instance.h. */
#include "libraries.h"

#define RF_EVENT_ITERATIONS 1000

typedef int (*rf_plain)(void *);
typedef struct {
  int needed, terminate, nominals, states, defined;
  double time;
} rf_info; /* fmi2EventInfo */

static rf_function rf_find(const rf_inner *n, const char *name) {
  char whole[80];
  snprintf(whole, sizeof whole, "fmi%d%s", n->model->version, name);
  return rf_symbol(n->library, whole);
}

/* ---- failures: the first one counts until the importer is told of it ---- */

static int rf_failed(rf_inner *n, int status, const char *format, ...) {
  char text[400];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  if (status > n->outer->status) n->outer->status = status;
  rf_log(n->outer, status, "%s: %s (t = %.9g s)", n->model->block, text, n->time);
  return 1;
}

/* Return whether a function has failed. A discarded evaluation is one. */
static int rf_wrong(rf_inner *n, const char *function, int status) {
  static const char *const words[] = {"OK", "Warning", "Discard", "Error", "Fatal", "Pending"};
  if (status == RF_OK || status == RF_WARNING) return 0;
  return rf_failed(n, status == RF_DISCARD ? RF_DISCARD : RF_ERROR, "fmi%d%s returned fmi%d%s", n->model->version,
                   function, n->model->version, status > 0 && status < 6 ? words[status] : "an unknown status");
}

static int rf_plainly(rf_inner *n, const char *function) {
  return rf_wrong(n, function, ((rf_plain)rf_find(n, function))(n->at.instance));
}

/* ---- instances ---- */

static void rf_heard(void *environment, const char *instance, int status, const char *category, const char *format, ...) {
  rf_inner *n = (rf_inner *)environment;
  char text[400];
  va_list arguments;
  (void)instance, (void)category;
  if (!n || !format) return;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  rf_log(n->outer, status >= RF_OK && status <= RF_FATAL ? status : RF_ERROR, "%s: %s", n->model->block, text);
}

static void rf_heard3(void *environment, int status, const char *category, const char *text) {
  rf_heard(environment, 0, status, category, "%s", text ? text : "");
}

static void rf_drop(rf_inner *n) {
  if (n->at.instance) ((void (*)(void *))rf_find(n, "FreeInstance"))(n->at.instance);
  n->at.instance = 0;
  n->fresh = n->begun = 0;
}

static int rf_instantiate(rf_inner *n) {
  typedef void *(*make2)(const char *, int, const char *, const char *, const rf_callbacks *, int, int);
  typedef void (*listener)(void *, int, const char *, const char *);
  typedef void *(*make3)(const char *, const char *, const char *, bool, bool, void *, listener);
  typedef void *(*step3)(const char *, const char *, const char *, bool, bool, bool, bool, const uint32_t *, size_t,
                         void *, listener, void *);
  typedef int (*listen2)(void *, int, size_t, const char *const *);
  typedef int (*listen3)(void *, bool, size_t, const char *const *);
  const rf_model *m = n->model;
  const int two = m->version == 2, steps = m->step > 0.0;
  const char *name = two ? "Instantiate" : steps ? "InstantiateCoSimulation" : "InstantiateModelExchange";
  const rf_function make = rf_find(n, name);
  n->at.instance = two     ? ((make2)make)(n->name, steps, m->token, n->resources, &n->callbacks, 0, 1)
                   : steps ? ((step3)make)(n->name, m->token, n->resources, false, true, false, false, 0, 0, n, rf_heard3, 0)
                           : ((make3)make)(n->name, m->token, n->resources, false, true, n, rf_heard3);
  if (!n->at.instance) return rf_failed(n, RF_ERROR, "fmi%d%s gave no instance", m->version, name);
  if (m->n_categories) {
    const rf_function listen = rf_find(n, "SetDebugLogging");
    if (two) ((listen2)listen)(n->at.instance, 1, (size_t)m->n_categories, m->categories);
    else ((listen3)listen)(n->at.instance, true, (size_t)m->n_categories, m->categories);
  }
  ++n->made;
  n->fresh = 1;
  n->begun = 0;
  return 0;
}

/* ---- begin ---- */

#define RF_WHOLE(CODE, TYPE, LOW, HIGH)                                                                              \
  case CODE:                                                                                                         \
    for (int k = 0; k < s->n; ++k) {                                                                                 \
      if (!(raw[k] >= LOW && raw[k] <= HIGH && raw[k] == floor(raw[k])))                                             \
        return rf_failed(n, RF_ERROR, "%.9g is not a value of type %s", raw[k], s->word);                            \
      ((TYPE *)n->buffer)[k] = (TYPE)raw[k];                                                                         \
    }                                                                                                                \
    break

static int rf_set_variable(rf_inner *n, const rf_setting *s) {
  typedef int (*set2)(void *, const uint32_t *, size_t, const void *);
  typedef int (*set3)(void *, const uint32_t *, size_t, const void *, size_t);
  const double *raw = n->values + s->at;
  char name[24];
  switch (s->type) {
    case RF_DOUBLE: memcpy(n->buffer, raw, (size_t)s->n * sizeof *raw); break;
    case RF_FLOAT:
      for (int k = 0; k < s->n; ++k) ((float *)n->buffer)[k] = (float)raw[k];
      break;
    case RF_BOOL:
      for (int k = 0; k < s->n; ++k) ((bool *)n->buffer)[k] = raw[k] != 0.0;
      break;
    case RF_TEXT:
      for (int k = 0; k < s->n; ++k) ((const char **)n->buffer)[k] = n->model->texts[s->at + k];
      break;
      RF_WHOLE(RF_I8, int8_t, -128.0, 127.0);
      RF_WHOLE(RF_U8, uint8_t, 0.0, 255.0);
      RF_WHOLE(RF_I16, int16_t, -32768.0, 32767.0);
      RF_WHOLE(RF_U16, uint16_t, 0.0, 65535.0);
      RF_WHOLE(RF_I32, int32_t, -2147483648.0, 2147483647.0);
      RF_WHOLE(RF_U32, uint32_t, 0.0, 4294967295.0);
      RF_WHOLE(RF_I64, int64_t, -9007199254740992.0, 9007199254740992.0);
      RF_WHOLE(RF_U64, uint64_t, 0.0, 9007199254740992.0);
  }
  snprintf(name, sizeof name, "Set%s", s->word);
  const rf_function function = rf_find(n, name);
  if (!function) return rf_failed(n, RF_ERROR, "its library has no function fmi%d%s", n->model->version, name);
  return rf_wrong(n, name, n->model->version == 2
                               ? ((set2)function)(n->at.instance, &s->reference, 1, n->buffer)
                               : ((set3)function)(n->at.instance, &s->reference, 1, n->buffer, (size_t)s->n));
}

/* Set what is not as the FMU has it by itself: parameters p, inputs u, SI, and constants. */
static int rf_set_variables(rf_inner *n, const double *p, const double *u) {
  const rf_model *m = n->model;
  for (int s = 0; s < m->n_settings; ++s) {
    const rf_setting *one = m->settings + s;
    int wanted = one->always;
    for (int k = one->at; !one->always && k < one->at + one->n; ++k) {
      const double value = k < m->n_p ? p[k] : u[k - m->n_p], start = m->starts[k];
      n->values[k] = (value - m->scales[2 * k + 1]) / m->scales[2 * k];
      wanted = wanted || (start == start ? value != start : value == value && value != 0.0);
    }
    if (wanted && rf_set_variable(n, one)) return 1;
  }
  return 0;
}

/* Iterate the event until nothing changes, go on in continuous time, and read the states. */
static int rf_settle(rf_inner *n) {
  typedef int (*update2)(void *, rf_info *);
  typedef int (*update3)(void *, bool *, bool *, bool *, bool *, bool *, double *);
  const int two = n->model->version == 2;
  const char *name = two ? "NewDiscreteStates" : "UpdateDiscreteStates";
  const rf_function update = rf_find(n, name);
  for (int count = 0;; ++count) {
    rf_info info = {0, 0, 0, 0, 0, 0.0};
    bool flag[5] = {false, false, false, false, false};
    if (count == RF_EVENT_ITERATIONS)
      return rf_failed(n, RF_ERROR, "the event does not end after %d iterations", RF_EVENT_ITERATIONS);
    if (rf_wrong(n, name,
                 two ? ((update2)update)(n->at.instance, &info)
                     : ((update3)update)(n->at.instance, flag, flag + 1, flag + 2, flag + 3, flag + 4, &info.time)))
      return 1;
    n->nominals |= info.nominals || flag[2];
    n->states |= info.states || flag[3];
    n->at.due = info.defined || flag[4] ? info.time : HUGE_VAL;
    if (info.terminate || flag[1]) {
      rf_log(n->outer, RF_WARNING, "%s asks for the end of the simulation (t = %.9g s)", n->model->block, n->time);
      return n->outer->ended = 1, 0;
    }
    if (!info.needed && !flag[0]) break;
  }
  if (rf_plainly(n, "EnterContinuousTimeMode")) return 1;
  return n->fmu.n_x && rf_wrong(n, "GetContinuousStates",
                                ((get_)rf_find(n, "GetContinuousStates"))(n->at.instance, n->x, (size_t)n->fmu.n_x));
}

/* Begin anew at a start time, with parameters p and inputs u, SI. */
static int rf_begin_inner(rf_inner *n, double start, const double *p, const double *u) {
  typedef int (*setup2)(void *, int, double, double, int, double);
  typedef int (*enter3)(void *, bool, double, double, bool, double);
  if (!n->fresh) {
    rf_drop(n);
    if (rf_instantiate(n)) return 1;
  }
  n->fresh = n->states = n->nominals = 0;
  n->time = n->since = start, n->steps = 0.0;
  if (rf_set_variables(n, p, u)) return 1;
  if (n->model->version == 2) {
    const rf_function setup = rf_find(n, "SetupExperiment");
    if (rf_wrong(n, "SetupExperiment", ((setup2)setup)(n->at.instance, 0, 0.0, start, 0, 0.0))) return 1;
    if (rf_plainly(n, "EnterInitializationMode")) return 1;
  } else {
    const rf_function enter = rf_find(n, "EnterInitializationMode");
    if (rf_wrong(n, "EnterInitializationMode", ((enter3)enter)(n->at.instance, false, 0.0, start, false, 0.0))) return 1;
  }
  if (rf_plainly(n, "ExitInitializationMode") || (!(n->model->step > 0.0) && rf_settle(n))) return 1;
  if (n->outer->ended) return rf_failed(n, RF_ERROR, "has ended the simulation where it begins");
  double *z = n->fmu.seen + n->fmu.n_u;
  if (n->fmu.n_z && rf_wrong(n, "GetEventIndicators", ((get_)n->fmu.get_z)(n->at.instance, z, (size_t)n->fmu.n_z)))
    return 1;
  for (int k = 0; k < n->fmu.n_z; ++k) n->outer->at.sides[n->model->at_z + k] = z[k] > 0.0 ? 1.0 : -1.0;
  memcpy(n->p, p, (size_t)n->fmu.n_p * sizeof *p);
  n->begun = 1;
  return 0;
}

/* ---- steps of Co-Simulation ---- */

static int rf_step_on(rf_inner *n) {
  typedef int (*do2)(void *, double, double, int);
  typedef int (*do3)(void *, double, double, bool, bool *, bool *, bool *, double *);
  typedef int (*ask2)(void *, int, int *);
  const double h = n->model->step, from = n->since + n->steps * h;
  const int two = n->model->version == 2;
  double last = 0.0;
  bool event = false, end = false, early = false;
  const rf_function step = rf_find(n, "DoStep"), ask = two ? rf_find(n, "GetBooleanStatus") : 0;
  const int status = two ? ((do2)step)(n->at.instance, from, h, 0)
                         : ((do3)step)(n->at.instance, from, h, false, &event, &end, &early, &last);
  int ended = 0; /* of FMI 2 a step that is discarded may be the last one: fmi2Terminated */
  if (two && status == RF_DISCARD && ask && !((ask2)ask)(n->at.instance, 3, &ended)) end = ended != 0;
  if (!end && rf_wrong(n, "DoStep", status)) return 1;
  n->steps += 1.0;
  n->time = from + h;
  if (end) {
    rf_log(n->outer, RF_WARNING, "%s asks for the end of the simulation (t = %.9g s)", n->model->block, n->time);
    n->outer->ended = 1;
  }
  return 0;
}

/* Take inputs u and step to t, where a step is due; put the outputs into n->out. Return whether it failed. The first time
 * there is none: it begins with these inputs. */
static int rf_step_inner(rf_inner *n, double t, const double *u, const double *p) {
  rs_fmu *f = &n->fmu;
  const int two = f->version == 2, begins = !n->begun;
  const double due = n->since + (n->steps + 1.0) * n->model->step;
  if (begins && rf_begin_inner(n, t, p, u)) return 1;
  if (!begins && memcmp(p, n->p, (size_t)f->n_p * sizeof *p))
    return rf_failed(n, RF_ERROR, "cannot take other parameters after its initialisation");
  /* at a hit of another block nobody takes what is told */
  if (!begins && t < due - 1e-6 * n->model->step - 8.0 * DBL_EPSILON * fabs(t)) return 0;
  for (int64_t k = 0; k < f->n_u; ++k) f->work[k] = (u[k] - f->u_scales[2 * k + 1]) / f->u_scales[2 * k];
  if (!begins && f->n_u &&
      rf_wrong(n, two ? "SetReal" : "SetFloat64", access_real(f, f->set_real, n->at.instance, 0, f->work, f->n_u)))
    return 1;
  if (!begins && rf_step_on(n)) return 1;
  if (f->n_y && rf_wrong(n, two ? "GetReal" : "GetFloat64", access_real(f, f->get_real, n->at.instance, 1, n->out, f->n_y)))
    return 1;
  for (int64_t k = 0; k < f->n_y; ++k) n->out[k] = f->y_scales[2 * k] * n->out[k] + f->y_scales[2 * k + 1];
  return 0;
}

/* ---- equations ---- */

/* Do once more, step by step, what has failed, and say what it was. */
static void rf_explain(rf_inner *n, double t, const double *x, const double *u, int rates, int outputs) {
  rs_fmu *f = &n->fmu;
  const int two = f->version == 2;
  void *c = n->at.instance;
  if (rf_wrong(n, "SetTime", ((time_)f->set_time)(c, t))) return;
  if (f->n_x && rf_wrong(n, "SetContinuousStates", ((set_)f->set_x)(c, x, (size_t)f->n_x))) return;
  for (int k = 0; k < f->n_u; ++k) f->work[k] = (u[k] - f->u_scales[2 * k + 1]) / f->u_scales[2 * k];
  if (f->n_u && rf_wrong(n, two ? "SetReal" : "SetFloat64", access_real(f, f->set_real, c, 0, f->work, f->n_u))) return;
  if (rates && f->n_x && rf_wrong(n, two ? "GetDerivatives" : "GetContinuousStateDerivatives",
                                  ((get_)f->get_xdot)(c, n->out, (size_t)f->n_x)))
    return;
  if (rates && f->n_z && rf_wrong(n, "GetEventIndicators", ((get_)f->get_z)(c, f->seen + f->n_u, (size_t)f->n_z))) return;
  if (outputs && f->n_y &&
      rf_wrong(n, two ? "GetReal" : "GetFloat64", access_real(f, f->get_real, c, 1, n->out + f->n_x, f->n_y)))
    return;
  rf_failed(n, RF_DISCARD, "gives %s that is not finite", rates ? "a derivative" : "an output");
}

/* Answer the generated code: function k at its arguments. What fails is told by `rf_outcome`, and is not a number here. */
static void rf_call(const double *p, int k, const double *arguments, double *results) {
  rf_instance *i = (rf_instance *)(uintptr_t)(p - RF_AT_P);
  const rs_function *self = i->calls + k;
  rf_inner *n = i->inner + rf_calls[k].inner;
  const double *part[4];
  int rates, outputs;
  parts(self, arguments, part, n->zeros, n->fmu.idle);
  wanted(self, &rates, &outputs);
  if (i->status < RF_DISCARD && rf_calls[k].what == RF_BY_STEPS) {
    if (!rf_step_inner(n, *part[0], part[2], part[3])) {
      if (taken(self, n->out, results)) return;
      rf_failed(n, RF_ERROR, "gives an output that is not finite");
    }
  } else if (i->status < RF_DISCARD && rf_calls[k].what == RF_AT_BEGIN) {
    if (!rf_begin_inner(n, i->d[RF_START], part[3], part[2])) {
      memcpy(results, n->x, (size_t)n->fmu.n_x * sizeof *results);
      return;
    }
  } else if (i->status < RF_DISCARD) {
    const int same = n->begun && memcmp(part[3], n->p, (size_t)n->fmu.n_p * sizeof *part[3]) == 0;
    if (n->begun && !same && !((int)i->d[RF_PHASE] & (RF_INSTANTIATED | RF_INITIALISING)))
      rf_failed(n, RF_ERROR, "cannot take other parameters after its initialisation");
    else if (same || !rf_begin_inner(n, i->d[RF_START], part[3], n->model->starts + n->fmu.n_p)) {
      n->time = *part[0];
      if (!n->fmu.n_x && *part[0] >= n->at.due)
        rf_failed(n, RF_ERROR, "has a time event at t = %.9g s and no states", n->at.due);
      else if (evaluated_here(&n->fmu, &n->at, *part[0], part[1], part[2], rates, outputs, n->out) &&
               taken(self, n->out, results))
        return;
      else
        rf_explain(n, *part[0], part[1], part[2], rates, outputs);
    }
  }
  for (int j = 0; j < (rf_calls[k].what == RF_AT_BEGIN ? n->fmu.n_x : self->n_rows); ++j) results[j] = NAN;
}

/* ---- the whole instance ---- */

/* Let all FMUs begin anew when they are asked next. */
static void rf_restart_inners(rf_instance *i) {
  for (int k = 0; k < RF_NESTED; ++k) i->inner[k].begun = 0;
  i->at.begun = i->ended = i->status = 0;
}

static void rf_terminate_inners(rf_instance *i) {
  for (int k = 0; k < RF_NESTED; ++k)
    if (i->inner[k].begun && rf_find(i->inner + k, "Terminate")) rf_plainly(i->inner + k, "Terminate");
}

static void rf_destroy_inners(rf_instance *i) {
  for (int k = 0; k < RF_NESTED; ++k) {
    rf_inner *n = i->inner + k;
    if (n->library) rf_drop(n), rf_unload(n->library);
    free(n->memory), free(n->buffer), free(n->name), free(n->resources);
    memset(n, 0, sizeof *n);
  }
}

/* Return whether its library has not all that is called. */
static int rf_lacks(rf_inner *n) {
  const rf_model *m = n->model;
  const int two = m->version == 2, states = m->n_x > 0, steps = m->step > 0.0;
  const struct {
    const char *name;
    int called;
  } functions[] = {{two ? "Instantiate" : steps ? "InstantiateCoSimulation" : "InstantiateModelExchange", 1},
                   {"FreeInstance", 1},
                   {"SetDebugLogging", m->n_categories > 0},
                   {"SetupExperiment", two},
                   {"EnterInitializationMode", 1},
                   {"ExitInitializationMode", 1},
                   {"EnterEventMode", states},
                   {two ? "NewDiscreteStates" : "UpdateDiscreteStates", !steps},
                   {"EnterContinuousTimeMode", !steps},
                   {"DoStep", steps},
                   {"CompletedIntegratorStep", states && m->reports},
                   {"SetTime", !steps},
                   {"SetContinuousStates", states},
                   {"GetContinuousStates", states},
                   {two ? "GetDerivatives" : "GetContinuousStateDerivatives", states},
                   {"GetEventIndicators", m->n_z > 0},
                   {two ? "SetReal" : "SetFloat64", m->n_u > 0},
                   {two ? "GetReal" : "GetFloat64", m->n_y > 0}};
  for (size_t k = 0; k < sizeof functions / sizeof *functions; ++k)
    if (functions[k].called && !rf_find(n, functions[k].name))
      return rf_failed(n, RF_ERROR, "its library has no function fmi%d%s", m->version, functions[k].name);
  return 0;
}

static int rf_create_inner(rf_inner *n, const char *root) {
  const rf_model *m = n->model;
  rs_fmu *f = &n->fmu;
  char *path = rf_joined(root, "/", m->library), *folder = m->resources ? rf_joined(root, "/", m->resources) : 0;
  const int two = m->version == 2, size = m->n_p + m->n_u + m->n_constants, point = 1 + m->n_x + m->n_u + m->n_p;
  n->resources = folder && two ? rf_uri_of(folder) : folder ? rf_joined(folder, "/", "") : 0;
  n->name = rf_joined(n->outer->name, ".", m->block);
  n->library = path ? rf_load(path) : 0;
  free(folder), free(path);
  n->buffer = calloc((size_t)m->largest + 1, sizeof(double));
  n->memory = (double *)calloc((size_t)(m->n_p + m->n_x + point + m->n_x + m->n_y + 1 + size + 2 * m->n_u + m->n_z + 1),
                               sizeof(double));
  if (!n->memory || !n->buffer || !n->name) return rf_failed(n, RF_ERROR, "not enough memory");
  if (!n->library) return rf_failed(n, RF_ERROR, "its library cannot be loaded: %s", rf_load_failure());
  if (rf_lacks(n)) return 1;
  n->p = n->memory;
  n->x = n->p + m->n_p;
  n->zeros = n->x + m->n_x;
  n->out = n->zeros + point;
  n->values = n->out + m->n_x + m->n_y + 1;
  f->work = n->values + size;
  f->seen = f->work + m->n_u;
  for (int k = 0; k < m->n_constants; ++k) n->values[m->n_p + m->n_u + k] = m->constants[k];
  f->version = m->version, f->n_x = m->n_x, f->n_u = m->n_u, f->n_y = m->n_y, f->n_z = m->n_z, f->n_p = m->n_p;
  f->counts[0] = m->counts[0], f->counts[1] = m->counts[1];
  f->refs[0] = m->u_refs, f->refs[1] = m->y_refs;
  f->u_scales = m->u_scales, f->y_scales = m->y_scales, f->idle = m->idle;
  *(rf_function *)(void *)&f->set_time = rf_find(n, "SetTime");
  *(rf_function *)(void *)&f->set_x = rf_find(n, "SetContinuousStates");
  *(rf_function *)(void *)&f->get_xdot = rf_find(n, two ? "GetDerivatives" : "GetContinuousStateDerivatives");
  *(rf_function *)(void *)&f->get_z = rf_find(n, "GetEventIndicators");
  *(rf_function *)(void *)&f->set_real = rf_find(n, two ? "SetReal" : "SetFloat64");
  *(rf_function *)(void *)&f->get_real = rf_find(n, two ? "GetReal" : "GetFloat64");
  n->callbacks.logger = rf_heard, n->callbacks.allocate = calloc, n->callbacks.release = free;
  n->callbacks.environment = n;
  return rf_instantiate(n);
}

/* Load and instantiate the FMUs inside; location: of the resources, a file URI or a path. */
static int rf_create_inners(rf_instance *i, const char *location) {
  char *root = location ? rf_path_of(location) : 0;
  int wrong = !root;
  if (wrong)
    rf_log(i, RF_ERROR, "the location of the resources, %s, is no folder of this machine: the FMUs inside are there",
           location ? location : "(none)");
  for (int k = 0; k < RF_NESTED; ++k) {
    i->inner[k].model = rf_models + k;
    i->inner[k].outer = i;
  }
  for (int k = 0; k < RF_NESTED && !wrong; ++k) wrong = rf_create_inner(i->inner + k, root);
  for (int k = 0; k < RF_CALLED; ++k) {
    rs_function *one = i->calls + k;
    one->fmu = &i->inner[rf_calls[k].inner].fmu;
    one->n_rows = rf_calls[k].n_rows;
    one->rows = rf_rows + rf_calls[k].at_row;
    for (int g = 0; g < 4; ++g) one->groups[g] = rf_calls[k].groups[g];
  }
  free(root);
  if (wrong) rf_destroy_inners(i);
  return wrong;
}
