/* Histories of strain at points, through parallel elements with memory.
 * D components of strain, M numbers of state and NP parameters per element; above this text stand
 *   element(e, s, p, f, sn):              stress f[D], new state sn[M]
 *   element_d(e, s, p, f, sn, fe, fs, ne, ns): and d f/d e, d f/d s, d sn/d e, d sn/d s, row-major
 */

static int same(const double *a, const double *b)
{
  for (int i = 0; i < M; ++i)
    if (a[i] != b[i]) return 0;
  return 1;
}

/* One step from states s to sn at the P strains e; tangent (P, D, D). */
void law_step(int P, int E, const double *e, const double *s, const double *p, double *f,
              double *sn, double *tangent)
{
  for (int i = 0; i < P; ++i) {
    double *ft = f + i * D, *tt = tangent + i * D * D;
    memset(ft, 0, D * sizeof(double));
    memset(tt, 0, D * D * sizeof(double));
    for (int j = 0; j < E; ++j) {
      const int at = i * E + j;
      double f1[D], fe[D * D], fs[D * M1], ne[M1 * D], ns[M1 * M1];
      element_d(e + i * D, s + at * M, p + at * NP, f1, sn + at * M, fe, fs, ne, ns);
      for (int c = 0; c < D; ++c) ft[c] += f1[c];
      for (int c = 0; c < D * D; ++c) tt[c] += fe[c];
    }
  }
}

/* Stress (P, T, D) over strain (P, T, D); the states s are carried on. */
void law_history(int P, int T, int E, const double *e, double *s, const double *p, double *f)
{
  for (int i = 0; i < P; ++i)
    for (int t = 0; t < T; ++t) {
      const double *et = e + (i * T + t) * D;
      double *ft = f + (i * T + t) * D;
      memset(ft, 0, D * sizeof(double));
      for (int j = 0; j < E; ++j) {
        const int at = i * E + j;
        double f1[D], sn[M1];
        element(et, s + at * M, p + at * NP, f1, sn);
        for (int c = 0; c < D; ++c) ft[c] += f1[c];
        for (int c = 0; c < M; ++c) s[at * M + c] = sn[c];
      }
    }
}

/* d sn/d X = ns d s/d X + ne d e/d X, in place; columns (component, harmonic). */
static void carry(int K, const double *ne, const double *ns, const double *synthesis, double *ds)
{
  double old[M1 * D * K];
  memcpy(old, ds, M * D * K * sizeof(double));
  for (int a = 0; a < M; ++a) {
    double *row = ds + a * D * K;
    for (int c = 0; c < D; ++c)
      for (int k = 0; k < K; ++k) row[c * K + k] = ne[a * D + c] * synthesis[k];
    for (int b = 0; b < M; ++b) {
      const double factor = ns[a * M + b];
      if (factor == 0.0) continue;
      const double *from = old + b * D * K;
      for (int q = 0; q < D * K; ++q) row[q] += factor * from[q];
    }
  }
}

/* d f/d X += fe d e/d X + fs d s/d X. */
static void stress_by_coefficients(int K, int moved, const double *fe, const double *fs,
                                   const double *synthesis, const double *ds, double *df)
{
  for (int a = 0; a < D; ++a) {
    double *row = df + a * D * K;
    for (int c = 0; c < D; ++c) {
      const double factor = fe[a * D + c];
      if (factor == 0.0) continue;
      for (int k = 0; k < K; ++k) row[c * K + k] += factor * synthesis[k];
    }
    if (!moved) continue;
    for (int b = 0; b < M; ++b) {
      const double factor = fs[a * M + b];
      if (factor == 0.0) continue;
      for (int q = 0; q < D * K; ++q) row[q] += factor * ds[b * D * K + q];
    }
  }
}

/* Harmonics F (P, D, K) of the last cycle's stress by those of strain X (P, D, K), and their
 * derivative J (P, D, K, D, K), or none; synthesis (T, K), analysis (K, T). Strain e and stress f
 * are (P, T, D); begun (P, E, M) are the states at the start of the last cycle, s those at its end.
 */
int law_harmonic(int P, int E, int K, int T, int cycles, const double *X, const double *synthesis,
                 const double *analysis, const double *p, double *s, double *begun, double *e,
                 double *f, double *F, double *J)
{
  double *ds = malloc((size_t)E * M1 * D * K * sizeof(double));
  double *df = malloc((size_t)D * D * K * sizeof(double));
  int *moved = malloc((size_t)E * sizeof(int));
  if (!ds || !df || !moved) { free(ds); free(df); free(moved); return 1; }
  for (int i = 0; i < P; ++i) {
    double *ei = e + (size_t)i * T * D, *fi = f + (size_t)i * T * D, *Fi = F + (size_t)i * D * K;
    double *Ji = J ? J + (size_t)i * D * K * D * K : NULL;
    for (int t = 0; t < T; ++t)
      for (int c = 0; c < D; ++c) {
        double sum = 0.0;
        for (int k = 0; k < K; ++k) sum += synthesis[t * K + k] * X[(i * D + c) * K + k];
        ei[t * D + c] = sum;
      }
    memset(ds, 0, (size_t)E * M1 * D * K * sizeof(double));
    memset(moved, 0, (size_t)E * sizeof(int));
    memset(fi, 0, (size_t)T * D * sizeof(double));
    memset(Fi, 0, (size_t)D * K * sizeof(double));
    if (Ji) memset(Ji, 0, (size_t)D * K * D * K * sizeof(double));
    for (int cycle = 0; cycle < cycles; ++cycle) {
      const int last = cycle == cycles - 1;
      if (last) memcpy(begun + (size_t)i * E * M, s + (size_t)i * E * M, (size_t)E * M * sizeof(double));
      for (int t = 0; t < T; ++t) {
        const double *g = synthesis + (size_t)t * K;
        if (last && Ji) memset(df, 0, (size_t)D * D * K * sizeof(double));
        for (int j = 0; j < E; ++j) {
          const size_t at = (size_t)i * E + j;
          double *sj = s + at * M, *dsj = ds + (size_t)j * M1 * D * K;
          double f1[D], sn[M1], fe[D * D], fs[D * M1], ne[M1 * D], ns[M1 * M1];
          if (!Ji) element(ei + t * D, sj, p + at * NP, f1, sn);
          else {
            element_d(ei + t * D, sj, p + at * NP, f1, sn, fe, fs, ne, ns);
            if (last) stress_by_coefficients(K, moved[j], fe, fs, g, dsj, df);
            /* An element that does not move carries its derivative on as it is. */
            if (M && !same(sj, sn)) { carry(K, ne, ns, g, dsj); moved[j] = 1; }
          }
          for (int c = 0; c < M; ++c) sj[c] = sn[c];
          if (last)
            for (int c = 0; c < D; ++c) fi[t * D + c] += f1[c];
        }
        if (!last) continue;
        for (int c = 0; c < D; ++c)
          for (int k = 0; k < K; ++k) {
            const double a = analysis[(size_t)k * T + t];
            Fi[c * K + k] += a * fi[t * D + c];
            if (!Ji) continue;
            double *row = Ji + (size_t)(c * K + k) * D * K;
            const double *from = df + (size_t)c * D * K;
            for (int q = 0; q < D * K; ++q) row[q] += a * from[q];
          }
      }
    }
  }
  free(ds); free(df); free(moved);
  return 0;
}
