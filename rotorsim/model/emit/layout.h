/* One instance is one block of numbers m, laid out as below; nothing else holds state. */
#define RS_AT_X 0
#define RS_AT_Z (RS_AT_X + RS_NX)
#define RS_AT_G (RS_AT_Z + RS_NZ)
#define RS_AT_C (RS_AT_G + 3 * RS_NG)
#define RS_AT_K (RS_AT_C + RS_NC)
#define RS_AT_W (RS_AT_K + (RS_STAGES + 1) * RS_NX)
#define RS_AT_HIT (RS_AT_W + RS_NW)
#define RS_AT_COUNT (RS_AT_HIT + RS_NS)
#define RS_AT_NEW (RS_AT_COUNT + RS_NS)
#define RS_AT_ROW (RS_AT_NEW + RS_NZ)
#define RS_AT_WORK (RS_AT_ROW + RS_NY)
#define RS_AT_D (RS_AT_WORK + RS_WORK) /* the length of the step, and what follows from it */
#define RS_AT_TURN (RS_AT_D + 1 + RS_ND)
#define RS_SIZE (RS_AT_TURN + (RS_NA ? 5 + RS_ANGLE * RS_NA : 0) + 1)

#if defined(RS_STATIC) /* an FMU shows its FMI functions alone */
#define RS_EXPORT static
#elif defined(_WIN32)
#define RS_EXPORT __declspec(dllexport)
#else
#define RS_EXPORT __attribute__((visibility("default")))
#endif

#define RS_LARGEST 1e290 /* of all states together, as in instance.py */

#if RS_NS > 0
static uint64_t rs_mix(uint64_t s) {
  s = (s ^ (s >> 30)) * 0xbf58476d1ce4e5b9ULL;
  s = (s ^ (s >> 27)) * 0x94d049bb133111ebULL;
  return s ^ (s >> 31);
}

/* Standard normal draw number j of hit k: a counter-based generator (splitmix64, Box-Muller). */
static double rs_normal(uint64_t seed, uint64_t k, uint64_t j) {
  const uint64_t base = rs_mix(rs_mix(seed + 0x9e3779b97f4a7c15ULL) + k) + 2 * j;
  const double u = ((double)(rs_mix(rs_mix(base)) >> 11) + 0.5) * 0x1p-53;
  const double v = (double)(rs_mix(rs_mix(base + 1)) >> 11) * 0x1p-53;
  return sqrt(-2.0 * log(u)) * cos(6.283185307179586 * v);
}
#endif
