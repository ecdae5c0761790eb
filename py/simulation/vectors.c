/* Numbers of LANES runs side by side, and their functions. Sines and the like are taken lane by lane
   in loops of their own, which become calls of glibc's vector forms (libmvec, within 4 units in the last place) where it
   has them: one loop for each, because a sine and a cosine of one angle in one loop become a sincos, which has none. */

#if defined(__x86_64__) && defined(__GLIBC__) && !defined(__clang__)
#define VECTOR_FORM(f) __attribute__((simd("notinbranch"))) double f(double);
#define VECTOR_FORM_2(f) __attribute__((simd("notinbranch"))) double f(double, double);
#if __GLIBC_PREREQ(2, 22)
VECTOR_FORM(sin) VECTOR_FORM(cos) VECTOR_FORM(exp) VECTOR_FORM(log) VECTOR_FORM_2(pow)
#endif
#if __GLIBC_PREREQ(2, 35)
VECTOR_FORM(tan) VECTOR_FORM(asin) VECTOR_FORM(acos) VECTOR_FORM(atan) VECTOR_FORM(sinh) VECTOR_FORM(cosh)
VECTOR_FORM(asinh) VECTOR_FORM(acosh) VECTOR_FORM(atanh) VECTOR_FORM(erf) VECTOR_FORM(log1p) VECTOR_FORM(expm1)
VECTOR_FORM_2(atan2) VECTOR_FORM_2(hypot)
#endif
#endif

#if defined(__AVX512F__)
#define WIDTH 8
#elif defined(__AVX__)
#define WIDTH 4
#else
#define WIDTH 2
#endif
#define LANES (2 * WIDTH)

typedef double Vector __attribute__((vector_size(8 * WIDTH)));
typedef long long Mask __attribute__((vector_size(8 * WIDTH))); /* all bits of a lane, or none */
typedef struct {
  Vector half[2]; /* two registers: while one waits for its result, the other works */
} Lanes;

#define LANE(lanes, l) (((double *)&(lanes))[l])

static inline Vector spread(double value) { return value - (Vector){0}; }

static inline Lanes in_all(double value) { return (Lanes){{spread(value), spread(value)}}; }

static inline Vector where_set(Mask mask, Vector value) { return (Vector)(mask & (Mask)value); } /* else 0 */

static inline Vector chosen(Mask mask, Vector value, Vector otherwise) {
  return (Vector)((mask & (Mask)value) | (~mask & (Mask)otherwise));
}

#define EACH_LANE(call)                  \
  double a[LANES], b[LANES], r[WIDTH];   \
  memcpy(a, &x, sizeof a);               \
  memcpy(b, &y, sizeof b);               \
  _Pragma("omp simd") for (int l = 0; l < WIDTH; l++) r[l] = call; \
  memcpy(&x, r, sizeof r);               \
  return x;
#define OF_ONE(f) static inline Vector vector_##f(Vector x) { Vector y = x; EACH_LANE(f(a[l])) }
#define OF_TWO(f) static inline Vector vector_##f(Vector x, Vector y) { EACH_LANE(f(a[l], b[l])) }

OF_ONE(sqrt) OF_ONE(floor) OF_ONE(ceil) OF_ONE(exp) OF_ONE(log) OF_ONE(sin) OF_ONE(cos) OF_ONE(tan) OF_ONE(asin)
OF_ONE(acos) OF_ONE(atan) OF_ONE(sinh) OF_ONE(cosh) OF_ONE(asinh) OF_ONE(acosh) OF_ONE(atanh) OF_ONE(erf)
OF_ONE(log1p) OF_ONE(expm1) OF_TWO(pow) OF_TWO(atan2) OF_TWO(hypot) OF_TWO(fmod) OF_TWO(remainder) OF_TWO(copysign)

static inline Vector vector_fabs(Vector x) { return (Vector)((Mask)x & 0x7fffffffffffffffLL); }

/* The number where the other is none, as C has it. */
static inline Vector vector_fmin(Vector x, Vector y) { return chosen((x < y) | (y != y), x, y); }
static inline Vector vector_fmax(Vector x, Vector y) { return chosen((x > y) | (y != y), x, y); }

static inline Vector vector_sign(Vector x) { return chosen(x < 0.0, spread(-1), chosen(x > 0.0, spread(1), x)); }

/* As hydrotwin_tanh, both of its branches. */
static inline Vector vector_tanh(Vector x) {
  Vector a = vector_fabs(x), s = x * x;
  Vector near = x * (135135 + s * (17325 + s * (378 + s))) / (135135 + s * (62370 + s * (3150 + s * 28)));
  Vector far = 1 - 2 / (vector_exp(2 * a) + 1);
  return chosen(a < 0.4, near, vector_copysign(far, x));
}
