/* Symmetric sparse matrices in dense blocks of B x B, of which each row holds the upper half, the
 * diagonal block first, times eight columns at once: arrays of n x B rows of eight numbers.
 */
typedef double eight __attribute__((vector_size(64), aligned(8), may_alias));

#define INLINE static inline __attribute__((always_inline))
#define EACH(i, n) _Pragma("GCC unroll 6") for (int i = 0; i < n; ++i)

/* out += a x */
INLINE void add(const int B, const double *a, const eight *x, eight *out) {
  EACH(r, B) EACH(c, B) out[r] += a[r * B + c] * x[c];
}

/* out += a^T x */
INLINE void add_transposed(const int B, const double *a, const eight *x, eight *out) {
  EACH(r, B) EACH(c, B) out[c] += a[r * B + c] * x[r];
}

/* y += A x */
INLINE void multiply(const int B, int n, const long *at, const int *column, const double *a,
                     const eight *x, eight *y) {
  for (long i = 0; i < n; ++i) {
    eight own[6] = {0}, from[6];
    EACH(r, B) from[r] = x[i * B + r];
    add(B, a + at[i] * B * B, from, own);
    for (long k = at[i] + 1; k < at[i + 1]; ++k) {
      add(B, a + k * B * B, x + (long)column[k] * B, own);
      add_transposed(B, a + k * B * B, from, y + (long)column[k] * B);
    }
    EACH(r, B) y[i * B + r] += own[r];
  }
}

/* Symmetric Gauss-Seidel from zero for b: z, and the residual r = b - A z, which is zero at first.
 * The diagonal blocks are A's and beyond them a diagonal, extra; inverse holds their inverses.
 */
INLINE void smooth(const int B, int n, const long *at, const int *column, const double *a,
                   const double *inverse, const double *extra, const eight *b, eight *z,
                   eight *r) {
  for (long i = 0; i < n; ++i) { /* r collects what the rows above take from this one */
    eight own[6], found[6] = {0};
    EACH(s, B) own[s] = b[i * B + s] - r[i * B + s];
    add(B, inverse + i * B * B, own, found);
    for (long k = at[i] + 1; k < at[i + 1]; ++k)
      add_transposed(B, a + k * B * B, found, r + (long)column[k] * B);
    EACH(s, B) z[i * B + s] = found[s], r[i * B + s] = (eight){0};
  }
  for (long i = n - 1; i >= 0; --i) {
    eight sum[6] = {0}, change[6] = {0};
    for (long k = at[i] + 1; k < at[i + 1]; ++k)
      add(B, a + k * B * B, z + (long)column[k] * B, sum);
    add(B, inverse + i * B * B, sum, change);
    for (long k = at[i] + 1; k < at[i + 1]; ++k)
      add_transposed(B, a + k * B * B, change, r + (long)column[k] * B);
    EACH(s, B) z[i * B + s] -= change[s], r[i * B + s] += extra[i * B + s] * z[i * B + s];
  }
}

#define SIZES(CALL)  \
  switch (size) {    \
    CALL(1) CALL(2) CALL(3) CALL(4) CALL(5) CALL(6) \
  }                  \
  return 1;

int blocks_multiply(int size, int n, const long *at, const int *column, const double *a,
                    const double *x, double *y) {
#define MULTIPLY(B) \
  case B: multiply(B, n, at, column, a, (const eight *)x, (eight *)y); return 0;
  SIZES(MULTIPLY)
}

int blocks_smooth(int size, int n, const long *at, const int *column, const double *a,
                  const double *inverse, const double *extra, const double *b, double *z,
                  double *r) {
#define SMOOTH(B)                                                                               \
  case B:                                                                                       \
    smooth(B, n, at, column, a, inverse, extra, (const eight *)b, (eight *)z, (eight *)r);      \
    return 0;
  SIZES(SMOOTH)
}
