/* Harmonics of stress of laws without memory, whose branches change within the cycle: Gauss's rule
 * between the phases at which a switch changes its sign.
 */

/* Whether what is convex and above zero at the ends, with these slopes, may not be so between them:
 * where the tangents meet.
 */
static int may_dip(double step, double g, double slope, double after, double slope_after)
{
  return slope < 0 && slope_after > 0
         && g + slope * (after - g - slope_after * step) / (slope - slope_after) < 0;
}

/* Both changes of a switch that turns between low and high, where it is before and after with these
 * slopes, if it changes at all.
 */
static int hidden(const watched *w, double low, double high, double before, double slope,
                  double after, double slope_after, double *to)
{
  const double sign = before >= 0 ? 1.0 : -1.0;
  double a = low, b = high, ga = before, gb = after, sa = slope, sb = slope_after;
  for (int i = 0; i < BISECTIONS && may_dip(b - a, sign * ga, sign * sa, sign * gb, sign * sb); ++i) {
    double turn;
    const double middle = 0.5 * (a + b), g = look(w, middle, &turn);
    if (!(sign * g >= 0)) {
      to[0] = crossing(w, a, middle, ga, g);
      to[1] = crossing(w, middle, b, g, gb);
      return 2;
    }
    if (sign * turn < 0) a = middle, ga = g, sa = turn;
    else b = middle, gb = g, sb = turn;
  }
  return 0;
}

/* Changes of all switches of one element, from T samples of them and of their slopes. */
static int element_events(watched *w, int T, const double *g, const double *slopes, double *to)
{
  const double step = TURN / T;
  int found = 0;
  for (w->number = 0; w->number < NS; ++w->number)
    for (int t = 0; t < T; ++t) {
      const int at = t * NS + w->number, after = (t + 1) % T * NS + w->number;
      const double low = t * step, high = low + step;
      if ((g[at] >= 0) != (g[after] >= 0)) {
        to[found++] = crossing(w, low, high, g[at], g[after]);
        continue;
      }
      const double sign = g[at] >= 0 ? 1.0 : -1.0;
      if (may_dip(step, sign * g[at], sign * slopes[at], sign * g[after], sign * slopes[after]))
        found += hidden(w, low, high, g[at], slopes[at], g[after], slopes[after], to + found);
    }
  return found;
}

static int ascending(const void *a, const void *b)
{
  const double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

/* F, and J or none, += those of a phase with a weight, whose basis is b. */
static void add_node(int E, int K, double weight, const double *Z, const double *p,
                     const double *restrict b, double *F, double *J)
{
  double e[DI], f[D] = {0.0}, fe[D * DI] = {0.0};
  combine(K, Z, b, e);
  for (int j = 0; j < E; ++j) {
    double f1[D], d1[D * DI], none[1];
    if (J) element_d(e, none, p + j * NP, f1, none, d1, none, none, none);
    else element(e, none, p + j * NP, f1, none);
    for (int a = 0; a < D; ++a) f[a] += f1[a];
    for (int a = 0; J && a < D * DI; ++a) fe[a] += d1[a];
  }
  const double share = weight * 2.0 / TURN;
  for (int a = 0; a < D; ++a)
    for (int k = 0; k < K && f[a] != 0.0; ++k) F[a * K + k] += (k ? share : 0.5 * share) * b[k] * f[a];
  for (int i = 0; J && i < D * DI; ++i) {
    if (fe[i] == 0.0) continue;
    const int a = i / DI, c = i % DI;
    for (int k = 0; k < K; ++k) {
      double *restrict row = J + ((size_t)(a * K + k) * DI + c) * K;
      const double factor = (k ? share : 0.5 * share) * b[k] * fe[i];
      for (int l = 0; l < K; ++l) row[l] += factor * b[l];
    }
  }
}

/* Harmonics F (P, D, K) of stress by those of the input, Z (P, DI, K), and their derivative
 * J (P, D, K, DI, K), or none. Zd are those of d e / d phase, synthesis (T, K) the T samples between
 * which a switch may turn once; between events there are panels of Gauss's rule of `order` nodes,
 * `panels` in a period without any. Nonzero: out of memory.
 */
int law_events(int P, int E, int K, int T, int panels, int order, const double *Z, const double *Zd,
               const double *synthesis, const double *p, const double *nodes,
               const double *weights, double *F, double *J)
{
  const size_t most = (size_t)2 * T * E * NS1 + panels + 1, one = (size_t)T * NS1;
  double *g = malloc((2 * one + most + K) * sizeof(double));
  if (!g) return 1;
  double *slopes = g + one, *ends = slopes + one, *b = ends + most;
  memset(F, 0, (size_t)P * D * K * sizeof(double));
  if (J) memset(J, 0, (size_t)P * D * K * DI * K * sizeof(double));
  for (int i = 0; i < P; ++i) {
    const double *Zi = Z + (size_t)i * DI * K, *pi = p + (size_t)i * E * NP;
    double *Fi = F + (size_t)i * D * K, *Ji = J ? J + (size_t)i * D * K * DI * K : NULL;
    watched w = {.K = K, .Z = Zi, .Zd = Zd + (size_t)i * DI * K, .b = b};
    int found = 0;
    for (int j = 0; NS && j < E; ++j) {
      w.p = pi + (size_t)j * NP;
      for (int t = 0; t < T; ++t) {
        double e[DI], de[DI], ge[NS1 * DI];
        combine(K, w.Z, synthesis + (size_t)t * K, e);
        combine(K, w.Zd, synthesis + (size_t)t * K, de);
        switches(e, w.s, w.p, g + t * NS, ge);
        for (int n = 0; n < NS; ++n) slopes[t * NS + n] = along(ge + n * DI, de);
      }
      found += element_events(&w, T, g, slopes, ends + found);
    }
    if (!found) {
      for (int t = 0; t < T; ++t)
        add_node(E, K, TURN / T, Zi, pi, synthesis + (size_t)t * K, Fi, Ji);
      continue;
    }
    for (int n = 0; n <= panels; ++n) ends[found++] = TURN * n / panels;
    qsort(ends, found, sizeof(double), ascending);
    for (int n = 1; n < found; ++n) {
      const double middle = 0.5 * (ends[n] + ends[n - 1]), half = 0.5 * (ends[n] - ends[n - 1]);
      for (int q = 0; half > 0 && q < order; ++q) {
        harmonics_at(middle + half * nodes[q], K, b);
        add_node(E, K, half * weights[q], Zi, pi, b, Fi, Ji);
      }
    }
  }
  free(g);
  return 0;
}
