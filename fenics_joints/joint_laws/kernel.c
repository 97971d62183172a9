/* Histories of strain at points, through parallel elements with memory.
 * D components of stress, DI of input e (the strain, and its rate after it if the law asks for it),
 * M numbers of state and NP parameters per element; above this text stand
 *   element(e, s, p, f, sn):              stress f[D], new state sn[M]
 *   element_d(e, s, p, f, sn, fe, fs, ne, ns): and d f/d e, d f/d s, d sn/d e, d sn/d s, row-major
 *   switches(e, s, p, g, ge):  g[NS], whose signs choose between a law's branches, and d g/d e
 * W elements go side by side, so that the compiler can compute them with vector instructions:
 * number i of element l of a group is at [i * W + l].
 */
#define W 4
#define NP1 (NP > 0 ? NP : 1)

static void elements(const double *restrict e, const double *restrict s, const double *restrict p,
                     double *restrict f, double *restrict sn)
{
#pragma GCC ivdep
  for (int l = 0; l < W; ++l) {
    double s1[M1], p1[NP1], f1[D], sn1[M1];
    for (int i = 0; i < M; ++i) s1[i] = s[i * W + l];
    for (int i = 0; i < NP; ++i) p1[i] = p[i * W + l];
    element(e, s1, p1, f1, sn1);
    for (int i = 0; i < D; ++i) f[i * W + l] = f1[i];
    for (int i = 0; i < M; ++i) sn[i * W + l] = sn1[i];
  }
}

typedef struct {
  double f[D * W], sn[M1 * W], fe[D * DI * W], fs[D * M1 * W], ne[M1 * DI * W], ns[M1 * M1 * W];
} derived;

static void elements_d(const double *restrict e, const double *restrict s,
                       const double *restrict p, derived *restrict to)
{
#pragma GCC ivdep
  for (int l = 0; l < W; ++l) {
    double s1[M1], p1[NP1], f1[D], sn1[M1], fe[D * DI], fs[D * M1], ne[M1 * DI], ns[M1 * M1];
    for (int i = 0; i < M; ++i) s1[i] = s[i * W + l];
    for (int i = 0; i < NP; ++i) p1[i] = p[i * W + l];
    element_d(e, s1, p1, f1, sn1, fe, fs, ne, ns);
    for (int i = 0; i < D; ++i) to->f[i * W + l] = f1[i];
    for (int i = 0; i < M; ++i) to->sn[i * W + l] = sn1[i];
    for (int i = 0; i < D * DI; ++i) to->fe[i * W + l] = fe[i];
    for (int i = 0; i < D * M; ++i) to->fs[i * W + l] = fs[i];
    for (int i = 0; i < M * DI; ++i) to->ne[i * W + l] = ne[i];
    for (int i = 0; i < M * M; ++i) to->ns[i * W + l] = ns[i];
  }
}

static int smaller(int a, int b) { return a < b ? a : b; }

/* n numbers of each of E elements, into groups of W and back; a group is filled with its last. */
static void group(int E, int n, const double *from, double *to)
{
  for (int j = 0; j < E; j += W)
    for (int i = 0; i < n; ++i)
      for (int l = 0; l < W; ++l) to[(j / W * n + i) * W + l] = from[smaller(j + l, E - 1) * n + i];
}

static void ungroup(int E, int n, const double *from, double *to)
{
  for (int j = 0; j < E; ++j)
    for (int i = 0; i < n; ++i) to[j * n + i] = from[(j / W * n + i) * W + j % W];
}

/* to[n] += the sums over the first elements of a group. */
static void add(int n, int count, const double *from, double *to)
{
  for (int i = 0; i < n; ++i)
    for (int l = 0; l < count; ++l) to[i] += from[i * W + l];
}

/* One step from states s to sn at the P inputs e; tangent (P, D, DI). Nonzero: out of memory. */
int law_step(int P, int E, const double *e, const double *s, const double *p, double *f,
             double *sn, double *tangent)
{
  const int groups = (E + W - 1) / W;
  double *sw = malloc((size_t)groups * W * (2 * M + NP + 1) * sizeof(double));
  if (!sw) return 1;
  double *snw = sw + groups * W * M, *pw = snw + groups * W * M;
  memset(f, 0, (size_t)P * D * sizeof(double));
  memset(tangent, 0, (size_t)P * D * DI * sizeof(double));
  for (int i = 0; i < P; ++i) {
    group(E, M, s + (size_t)i * E * M, sw);
    group(E, NP, p + (size_t)i * E * NP, pw);
    for (int j = 0; j < groups; ++j) {
      derived now;
      const int count = smaller(W, E - j * W);
      elements_d(e + (size_t)i * DI, sw + j * W * M, pw + j * W * NP, &now);
      memcpy(snw + j * W * M, now.sn, W * M * sizeof(double));
      add(D, count, now.f, f + i * D);
      add(D * DI, count, now.fe, tangent + (size_t)i * D * DI);
    }
    ungroup(E, M, snw, sn + (size_t)i * E * M);
  }
  free(sw);
  return 0;
}

/* Stress (P, T, D) over input (P, T, DI); the states s are carried on. Nonzero: out of memory. */
int law_history(int P, int T, int E, const double *e, double *s, const double *p, double *f)
{
  const int groups = (E + W - 1) / W;
  double *sw = malloc((size_t)groups * W * (M + NP + 1) * sizeof(double));
  if (!sw) return 1;
  double *pw = sw + groups * W * M;
  memset(f, 0, (size_t)P * T * D * sizeof(double));
  for (int i = 0; i < P; ++i) {
    group(E, M, s + (size_t)i * E * M, sw);
    group(E, NP, p + (size_t)i * E * NP, pw);
    for (int t = 0; t < T; ++t)
      for (int j = 0; j < groups; ++j) {
        const size_t at = (size_t)i * T + t;
        double fw[D * W], sn[M1 * W];
        elements(e + at * DI, sw + j * W * M, pw + j * W * NP, fw, sn);
        memcpy(sw + j * W * M, sn, W * M * sizeof(double));
        add(D, smaller(W, E - j * W), fw, f + at * D);
      }
    ungroup(E, M, sw, s + (size_t)i * E * M);
  }
  free(sw);
  return 0;
}

int law_switch_count(void) { return NS; }

/* Derivatives of every step of a history e (P, T, DI) from the states s (P, E, M), which are carried
 * on: fe (P, T, D, DI) of the stress by the input; of each element fs (P, T, E, D, M) by the state
 * before the step, ne (P, T, E, M, DI) and ns (P, T, E, M, M) of the state after it.
 */
int law_slopes(int P, int T, int E, const double *e, double *s, const double *p, double *fe,
               double *fs, double *ne, double *ns)
{
  memset(fe, 0, (size_t)P * T * D * DI * sizeof(double));
  for (int i = 0; i < P; ++i)
    for (int t = 0; t < T; ++t) {
      const size_t at = (size_t)i * T + t;
      for (int j = 0; j < E; ++j) {
        double f[D], sn[M1], d1[D * DI], d2[D * M1], d3[M1 * DI], d4[M1 * M1];
        double *state = s + ((size_t)i * E + j) * M;
        const size_t one = at * E + j;
        element_d(e + at * DI, state, p + ((size_t)i * E + j) * NP, f, sn, d1, d2, d3, d4);
        for (int n = 0; n < D * DI; ++n) fe[at * D * DI + n] += d1[n];
        memcpy(fs + one * D * M, d2, D * M * sizeof(double));
        memcpy(ne + one * M * DI, d3, M * DI * sizeof(double));
        memcpy(ns + one * M * M, d4, M * M * sizeof(double));
        memcpy(state, sn, M * sizeof(double));
      }
    }
  return 0;
}
