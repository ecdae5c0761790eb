/* Dynamic time warping within a band, as `warping.warped` says it; compiled by `simulation/compiler`. */

#include <float.h>

#if defined(_WIN32)
#define SEEN __declspec(dllexport)
#else
#define SEEN __attribute__((visibility("default")))
#endif

enum { FIRST, SECOND, BOTH }; /* what moved one sample on; of equal ways the first is taken */

/* Path through (n,) curves at most `reach` samples apart, into `one` and `two` (2 n,), last pair first; its length.

   sums : (2, n + 1), ways : (n, 2 reach + 1) of room. */
SEEN long long warp(long long n, long long reach, const double *a, const double *b, double *sums, signed char *ways,
                    long long *one, long long *two) {
  const long long wide = 2 * reach + 1;
  for (long long j = 0; j < 2 * (n + 1); j++) sums[j] = DBL_MAX;
  sums[0] = 0.0; /* before the first pair */
  for (long long i = 0; i < n; i++) {
    const double *before = sums + (i % 2) * (n + 1); /* of i - 1, one place after the index into b */
    double *now = sums + ((i + 1) % 2) * (n + 1);
    const long long low = i > reach ? i - reach : 0, high = i + reach < n ? i + reach : n - 1;
    now[low] = DBL_MAX; /* left of the band */
    for (long long j = low; j <= high; j++) {
      const double off = a[i] - b[j];
      signed char way = FIRST;
      double least = before[j + 1];
      if (now[j] < least) least = now[j], way = SECOND;
      if (before[j] < least) least = before[j], way = BOTH;
      now[j + 1] = off * off + least;
      ways[i * wide + j - i + reach] = way;
    }
    if (high + 2 <= n) now[high + 2] = DBL_MAX; /* right of it, for the next row */
  }
  long long i = n - 1, j = n - 1, length = 0;
  for (;;) {
    one[length] = i, two[length++] = j;
    if (!i && !j) return length;
    const signed char way = ways[i * wide + j - i + reach];
    i -= way != SECOND, j -= way != FIRST;
  }
}
