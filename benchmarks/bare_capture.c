/* A net with contact of threads on a free box, as little code as it takes: what benchmarks/captures.py compares with.

   Semi-implicit (leapfrog) steps. Cable law with viscous stress. Of each thread the place nearest to the box, by
   bisection on the slope of the distance: penalty per length times the thread's length, Hunt-Crossley damping,
   regularised Coulomb friction, shared to the ends by the lever; reaction and torque on the box. */
#include <math.h>
#include <string.h>

typedef struct {
  double half[3], rounding, radius, mass, inertia[3], stiffness, damping, friction, slip;
} Box;

static double core(const Box *b, const double *p, double *g) {
  double q[3], sum = 0.0, worst = -1e300;
  int axis = 0;
  for (int c = 0; c < 3; c++) {
    q[c] = fabs(p[c]) - b->half[c];
    if (q[c] > worst) worst = q[c], axis = c;
    g[c] = 0.0;
  }
  if (worst <= 0.0) {
    g[axis] = p[axis] >= 0.0 ? 1.0 : -1.0;
    return worst;
  }
  for (int c = 0; c < 3; c++)
    if (q[c] > 0.0) sum += q[c] * q[c];
  sum = sqrt(sum);
  for (int c = 0; c < 3; c++)
    if (q[c] > 0.0) g[c] = (p[c] >= 0.0 ? q[c] : -q[c]) / sum;
  return sum;
}

static void turn(const double *q, double r[3][3]) {
  const double w = q[0], i = q[1], j = q[2], k = q[3];
  const double m[3][3] = {{1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j)},
                          {2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i)},
                          {2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j)}};
  memcpy(r, m, sizeof m);
}

/* x, v: (3 n) of the nodes; s: centre (3), velocity (3), quaternion (4), angular velocity in body axes (3).
   Returns how many threads touched in the last step. */
long march(int n, int m, const int *ends, const double *length, const double *ea, const double *twice,
           const double *thick, const double *inverse, const Box *b, double *x, double *v, double *s, double *f,
           double h, long steps) {
  long touching = 0;
  for (long step = 0; step < steps; step++) {
    double R[3][3], F[3] = {0, 0, 0}, T[3] = {0, 0, 0};
    memset(f, 0, 3 * n * sizeof(double));
    touching = 0;
    turn(s + 6, R);
    for (int e = 0; e < m; e++) {
      const int i = 3 * ends[2 * e], j = 3 * ends[2 * e + 1];
      const double d[3] = {x[j] - x[i], x[j + 1] - x[i + 1], x[j + 2] - x[i + 2]};
      const double L2 = length[e] * length[e];
      double excess = d[0] * d[0] + d[1] * d[1] + d[2] * d[2] - L2;
      if (excess > 0.0) {
        excess += twice[e] * (d[0] * (v[j] - v[i]) + d[1] * (v[j + 1] - v[i + 1]) + d[2] * (v[j + 2] - v[i + 2]));
        if (excess > 0.0) {
          excess *= ea[e] / (2.0 * L2 * length[e]);
          for (int c = 0; c < 3; c++) f[i + c] += excess * d[c], f[j + c] -= excess * d[c];
        }
      }
      /* the bounding ball, then slabs, then bisection */
      const double mid[3] = {0.5 * (x[i] + x[j]) - s[0], 0.5 * (x[i + 1] + x[j + 1]) - s[1],
                             0.5 * (x[i + 2] + x[j + 2]) - s[2]};
      const double far = b->radius + thick[e] + 0.75 * length[e];
      if (mid[0] * mid[0] + mid[1] * mid[1] + mid[2] * mid[2] > far * far) continue;
      double a[3], w[3], g[3];
      int out = 0;
      const double reach = b->rounding + thick[e];
      for (int c = 0; c < 3; c++) {
        a[c] = w[c] = 0.0;
        for (int k = 0; k < 3; k++) a[c] += R[k][c] * (x[i + k] - s[k]), w[c] += R[k][c] * d[k];
        const double low = w[c] < 0.0 ? a[c] + w[c] : a[c], high = w[c] < 0.0 ? a[c] : a[c] + w[c];
        out |= low > b->half[c] + reach || high < -b->half[c] - reach;
      }
      if (out) continue;
      double low = 0.0, high = 1.0, p[3], at = 0.5;
      for (int k = 0; k < 40 && high - low > 1e-6; k++) {
        at = 0.5 * (low + high);
        for (int c = 0; c < 3; c++) p[c] = a[c] + at * w[c];
        core(b, p, g);
        if (g[0] * w[0] + g[1] * w[1] + g[2] * w[2] < 0.0) low = at;
        else high = at;
      }
      for (int c = 0; c < 3; c++) p[c] = a[c] + at * w[c];
      const double depth = reach - core(b, p, g);
      if (depth <= 0.0) continue;
      touching++;
      double u[3], rate = 0.0, normal, along = 0.0, t[3], y[3], world;
      for (int c = 0; c < 3; c++) {
        u[c] = 0.0;
        for (int k = 0; k < 3; k++)
          u[c] += R[k][c] * (v[i + k] + at * (v[j + k] - v[i + k]) - s[3 + k]);
      }
      u[0] -= s[11] * p[2] - s[12] * p[1];
      u[1] -= s[12] * p[0] - s[10] * p[2];
      u[2] -= s[10] * p[1] - s[11] * p[0];
      for (int c = 0; c < 3; c++) rate -= g[c] * u[c];
      normal = b->stiffness * length[e] * depth * (1.0 + b->damping * rate);
      if (normal <= 0.0) continue;
      for (int c = 0; c < 3; c++) t[c] = u[c] + rate * g[c], along += t[c] * t[c];
      along = sqrt(along + b->slip * b->slip);
      for (int c = 0; c < 3; c++) y[c] = normal * (g[c] - b->friction * t[c] / along);
      T[0] -= p[1] * y[2] - p[2] * y[1];
      T[1] -= p[2] * y[0] - p[0] * y[2];
      T[2] -= p[0] * y[1] - p[1] * y[0];
      for (int k = 0; k < 3; k++) {
        world = R[k][0] * y[0] + R[k][1] * y[1] + R[k][2] * y[2];
        F[k] -= world;
        f[i + k] += (1.0 - at) * world;
        f[j + k] += at * world;
      }
    }
    for (int c = 0; c < 3 * n; c++) v[c] += h * f[c] * inverse[c / 3], x[c] += h * v[c];
    const double *I = b->inertia;
    double *o = s + 10, *q = s + 6;
    const double gyro[3] = {(I[1] - I[2]) * o[1] * o[2], (I[2] - I[0]) * o[2] * o[0], (I[0] - I[1]) * o[0] * o[1]};
    for (int c = 0; c < 3; c++) {
      s[3 + c] += h * F[c] / b->mass;
      s[c] += h * s[3 + c];
      o[c] += h * (T[c] + gyro[c]) / I[c];
    }
    const double dq[4] = {-0.5 * (q[1] * o[0] + q[2] * o[1] + q[3] * o[2]),
                          0.5 * (q[0] * o[0] + q[2] * o[2] - q[3] * o[1]),
                          0.5 * (q[0] * o[1] + q[3] * o[0] - q[1] * o[2]),
                          0.5 * (q[0] * o[2] + q[1] * o[1] - q[2] * o[0])};
    double size = 0.0;
    for (int c = 0; c < 4; c++) q[c] += h * dq[c], size += q[c] * q[c];
    for (int c = 0; c < 4; c++) q[c] /= sqrt(size);
  }
  return touching;
}
