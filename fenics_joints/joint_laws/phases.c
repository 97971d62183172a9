/* Phases at which the switches of a law change their signs. Phases go from 0 to 2 pi; Z are
 * harmonics of the input, (DI, K), Zd those of its derivative by the phase.
 */
#define NS1 (NS > 0 ? NS : 1)
#define TURN 6.283185307179586477
#define BISECTIONS 40
#define NEWTONS 60
#define NEAR 1e-7 /* a step of Newton's method after which the error is its square */

/* 1, cos, sin, cos 2, sin 2, ... of a phase. */
static void harmonics_at(double phase, int K, double *b)
{
  const double c = cos(phase), s = sin(phase);
  double ck = c, sk = s;
  b[0] = 1.0;
  for (int k = 1; k < K; k += 2) {
    b[k] = ck;
    b[k + 1] = sk;
    const double next = ck * c - sk * s;
    sk = sk * c + ck * s;
    ck = next;
  }
}

static void combine(int K, const double *Z, const double *restrict b, double *e)
{
  for (int i = 0; i < DI; ++i) {
    double sum = 0.0;
    for (int k = 0; k < K; ++k) sum += Z[i * K + k] * b[k];
    e[i] = sum;
  }
}

/* What one switch of an element is looked at with; s is the element's state. */
typedef struct {
  int K, number;
  const double *Z, *Zd, *s, *p;
  double *b;
} watched;

static double along(const double *ge, const double *de)
{
  double sum = 0.0;
  for (int i = 0; i < DI; ++i) sum += ge[i] * de[i];
  return sum;
}

/* The switch at an input and its derivative by the phase, and its slope by it. */
static double look_at(const watched *w, const double *e, const double *de, double *slope)
{
  double g[NS1], ge[NS1 * DI];
  switches(e, w->s, w->p, g, ge);
  *slope = along(ge + w->number * DI, de);
  return g[w->number];
}

/* The switch at a phase, and its slope by it. */
static double look(const watched *w, double phase, double *slope)
{
  double e[DI], de[DI];
  harmonics_at(phase, w->K, w->b);
  combine(w->K, w->Z, w->b, e);
  combine(w->K, w->Zd, w->b, de);
  return look_at(w, e, de, slope);
}

/* The phase between low and high at which the switch, before at low, changes its sign, by Newton's
 * method.
 */
static double crossing(const watched *w, double low, double high, double before)
{
  double slope, x = 0.5 * (low + high);
  const int positive = before >= 0;
  for (int i = 0; i < NEWTONS; ++i) {
    if (!(x > low && x < high)) x = 0.5 * (low + high);
    const double g = look(w, x, &slope);
    if ((g >= 0) == positive) low = x;
    else high = x;
    const double moved = g / slope;
    x -= moved;
    if (fabs(moved) < NEAR && x > low - NEAR && x < high + NEAR) break;
  }
  return fmin(fmax(x, low), high);
}

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
      to[0] = crossing(w, a, middle, ga);
      to[1] = crossing(w, middle, b, g);
      return 2;
    }
    if (sign * turn < 0) a = middle, ga = g, sa = turn;
    else b = middle, gb = g, sb = turn;
  }
  return 0;
}
