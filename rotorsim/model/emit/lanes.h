/* Numbers of an ensemble: a vector with a lane for each of RS_LANES runs, in the extension of gcc and clang.
 *
 * Lane by lane they are what doubles are in a single run: the same operations, and the same functions of the library. */
typedef double rs_lanes __attribute__((vector_size(8 * RS_LANES)));
typedef int64_t rs_mask __attribute__((vector_size(8 * RS_LANES))); /* of a comparison: all bits or none */

static const rs_lanes rs_zeros;
#define rs_all(a) ((a) - (rs_lanes){0}) /* minus, not plus: -0.0 stays what it is */

static inline rs_lanes rs_where(rs_mask here, rs_lanes a) { return (rs_lanes)(here & (rs_mask)a); }
static inline rs_lanes rs_true(rs_mask here) { return rs_where(here, rs_all(1.0)); }
static inline rs_lanes rs_either(rs_mask here, rs_lanes a, rs_lanes b) {
  return (rs_lanes)((here & (rs_mask)a) | (~here & (rs_mask)b));
}

#define RS_EACH(f)                                     \
  static inline rs_lanes rs_##f(rs_lanes a) {          \
    for (int k = 0; k < RS_LANES; ++k) a[k] = f(a[k]); \
    return a;                                          \
  }
#define RS_EACH_PAIR(f)                                      \
  static inline rs_lanes rs_##f(rs_lanes a, rs_lanes b) {    \
    for (int k = 0; k < RS_LANES; ++k) a[k] = f(a[k], b[k]); \
    return a;                                                \
  }
RS_EACH(exp) RS_EACH(log) RS_EACH(sqrt) RS_EACH(sin) RS_EACH(cos) RS_EACH(tan) RS_EACH(asin) RS_EACH(acos)
RS_EACH(atan) RS_EACH(floor) RS_EACH(ceil) RS_EACH(fabs) RS_EACH(erf) RS_EACH(sinh) RS_EACH(cosh) RS_EACH(tanh)
RS_EACH(asinh) RS_EACH(acosh) RS_EACH(atanh) RS_EACH(log1p) RS_EACH(expm1)
RS_EACH_PAIR(pow) RS_EACH_PAIR(fmod) RS_EACH_PAIR(copysign) RS_EACH_PAIR(fmin) RS_EACH_PAIR(fmax)
RS_EACH_PAIR(atan2) RS_EACH_PAIR(hypot) RS_EACH_PAIR(remainder)
