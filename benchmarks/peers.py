"""The same net in other programs, for benchmarks/work_precision.py.

A runner is called as runner(problem, setting) -> (seconds of the stepping, speeds of the bullets at the end),
and raises `Missing` where its program is not installed.
"""

from __future__ import annotations

import ctypes
import functools
import shutil
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.sparse import csr_array

Floats = NDArray[np.float64]
Outcome = tuple[float, Floats]


class Missing(Exception):
    """A program that is not installed."""


@dataclass(frozen=True, eq=False)
class Problem:
    """The undamped net as arrays: ends (m,), masses (n,) [kg], L0 (m,) [m], EA (m,) [N], state (n, 3),
    end [s], and the longest step [s] of exunet's plan, from which the bare loop takes its own."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    mass: Floats
    length: Floats
    stiffness: Floats
    position: Floats
    velocity: Floats
    bullets: NDArray[np.int64]
    end: float
    longest_step: float

    def speeds(self, velocity: Floats) -> Floats:
        """Of the bullets, from the velocities of all nodes in any shape [m/s]."""
        return np.linalg.norm(velocity.reshape(-1, 3)[self.bullets], axis=1)


def scipy(problem: Problem, setting: tuple[str, float]) -> Outcome:
    """solve_ivp over a NumPy force; setting: method, rtol (atol = rtol)."""
    method, tolerance = setting
    m, n = len(problem.length), len(problem.mass)
    i, j = problem.first, problem.second
    columns = np.arange(m)
    gather = csr_array(
        (np.repeat([1.0, -1.0], m), (np.concatenate([i, j]), np.tile(columns, 2))), shape=(n, m)
    )
    square, factor = problem.length**2, problem.stiffness / (2.0 * problem.length**3)
    inverse = 1.0 / problem.mass[:, None]

    def rate(_t: float, y: Floats) -> Floats:
        x = y[: 3 * n].reshape(n, 3)
        d = x[j] - x[i]
        stress = np.maximum(np.einsum("ea,ea->e", d, d) - square, 0.0) * factor
        return np.concatenate([y[3 * n :], (gather @ (d * stress[:, None]) * inverse).ravel()])

    start = np.concatenate([problem.position.ravel(), problem.velocity.ravel()])
    began = time.perf_counter()
    found = solve_ivp(
        rate, (0.0, problem.end), start, method=method, rtol=tolerance, atol=tolerance, t_eval=[problem.end]
    )
    return time.perf_counter() - began, problem.speeds(found.y[3 * n :, -1])


OCTAVE = """\
load('{folder}/net.mat');
n = numel(mass); m = numel(len);
G = sparse([first; second], [1:m, 1:m]', [ones(m, 1); -ones(m, 1)], n, m);
square = len.^2; factor = stiffness ./ (2 * len.^3);
function dy = rate(t, y, n, first, second, G, square, factor, mass)
  x = reshape(y(1:3*n), n, 3);
  d = x(second, :) - x(first, :);
  s = max(sum(d.^2, 2) - square, 0) .* factor;
  dy = [y(3*n+1:end); reshape((G * (d .* s)) ./ mass, 3*n, 1)];
end
opt = odeset('RelTol', {tolerance!r}, 'AbsTol', {tolerance!r});
tic;
f = @(t, y) rate(t, y, n, first, second, G, square, factor, mass);
[t, y] = ode45(f, [0, {end!r}], [x0(:); v0(:)], opt);
seconds = toc;
v = reshape(y(end, 3*n+1:end), n, 3);
printf('%.17g\\n', seconds, sqrt(sum(v(bullets, :).^2, 2)));
"""


def octave(problem: Problem, tolerance: float) -> Outcome:
    """ode45 of GNU Octave over a vectorised force; setting: RelTol = AbsTol."""
    from scipy.io import savemat

    program = shutil.which("octave-cli")
    if program is None:
        raise Missing("GNU Octave is not installed")
    with tempfile.TemporaryDirectory() as folder:
        arrays = {
            "first": problem.first[:, None] + 1.0, "second": problem.second[:, None] + 1.0,
            "mass": problem.mass[:, None], "len": problem.length[:, None],
            "stiffness": problem.stiffness[:, None], "x0": problem.position, "v0": problem.velocity,
            "bullets": problem.bullets[:, None] + 1.0,
        }  # fmt: skip
        savemat(Path(folder) / "net.mat", arrays)
        script = Path(folder) / "net.m"
        script.write_text(OCTAVE.format(folder=folder, tolerance=tolerance, end=problem.end))
        done = subprocess.run([program, "--quiet", str(script)], capture_output=True, text=True, check=True)
    numbers = [float(word) for word in done.stdout.split()]
    return numbers[0], np.array(numbers[1:])


def mujoco(problem: Problem, setting: tuple[str, float]) -> Outcome:
    """MuJoCo, tendons with springlength "0 L" and the exact cubic law; setting: integrator, timestep."""
    try:
        import mujoco as engine
    except ImportError:
        raise Missing("MuJoCo is not installed") from None
    integrator, step = setting
    bodies, tendons = [], []
    for k, (mass, place) in enumerate(zip(problem.mass, problem.position, strict=True)):
        joints = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
        where = " ".join(repr(float(c)) for c in place)
        bodies.append(
            f'<body pos="{where}">{joints}<inertial pos="0 0 0" mass="{float(mass)!r}" '
            f'diaginertia="1 1 1"/><site name="s{k}"/></body>'
        )
    for i, j, length in zip(problem.first, problem.second, problem.length, strict=True):
        tendons.append(
            f'<spatial springlength="0 {float(length)!r}" stiffness="1"><site site="s{i}"/>'
            f'<site site="s{j}"/></spatial>'
        )
    model = engine.MjModel.from_xml_string(
        f'<mujoco><option gravity="0 0 0" timestep="{step!r}" integrator="{integrator}">'
        '<flag contact="disable" constraint="disable"/></option><worldbody>'
        f"{''.join(bodies)}</worldbody><tendon>{''.join(tendons)}</tendon></mujoco>"
    )
    # N = EA (L^2 - L0^2) / (2 L0^2) L / L0, written in the elongation.
    model.tendon_stiffness[:] = problem.stiffness / problem.length
    model.tendon_stiffnesspoly[:, 0] = 1.5 * problem.stiffness / problem.length**2
    model.tendon_stiffnesspoly[:, 1] = 0.5 * problem.stiffness / problem.length**3
    data = engine.MjData(model)
    data.qvel[:] = problem.velocity.ravel()
    steps = round(problem.end / step)
    began = time.perf_counter()
    engine.mj_step(model, data, steps)
    return time.perf_counter() - began, problem.speeds(np.array(data.qvel))


BARE = r"""
#include <math.h>
#include <stdlib.h>
#include <string.h>
static void rate(int n, int m, const int *e, const double *sq, const double *fac, const double *inv,
                 const double *x, double *a) {
  memset(a, 0, 3 * n * sizeof(double));
  for (int k = 0; k < m; k++) {
    const int i = 3 * e[2 * k], j = 3 * e[2 * k + 1];
    const double dx = x[j] - x[i], dy = x[j + 1] - x[i + 1], dz = x[j + 2] - x[i + 2];
    double s = dx * dx + dy * dy + dz * dz - sq[k];
    if (s > 0.0) {
      s *= fac[k];
      a[i] += s * dx; a[i + 1] += s * dy; a[i + 2] += s * dz;
      a[j] -= s * dx; a[j + 1] -= s * dy; a[j + 2] -= s * dz;
    }
  }
  for (int c = 0; c < 3 * n; c++) a[c] *= inv[c];
}
#define EACH for (int c = 0; c < N; c++)
#define STAGE(kk) memcpy(kk, z + 3 * n, 3 * n * sizeof(double)); rate(n, m, e, sq, fac, inv, z, kk + 3 * n);
/* Dormand and Prince 5(4), y = (x, v), first same as last; returns the accepted steps. */
long march(int n, int m, const int *e, const double *sq, const double *fac, const double *inv,
           double *restrict y, double end, double tol, double first, double longest, long *rejected) {
  const int N = 6 * n;
  double *block = malloc(8 * N * sizeof(double));
  double *restrict k1 = block, *restrict k2 = k1 + N, *restrict k3 = k2 + N, *restrict k4 = k3 + N;
  double *restrict k5 = k4 + N, *restrict k6 = k5 + N, *restrict k7 = k6 + N, *restrict z = k7 + N;
  double t = 0, h = first;
  long steps = 0;
  memcpy(k1, y + 3 * n, 3 * n * sizeof(double));
  rate(n, m, e, sq, fac, inv, y, k1 + 3 * n);
  while (t < end) {
    if (h > longest) h = longest;
    if (t + h > end) h = end - t;
    EACH z[c] = y[c] + h * (1. / 5) * k1[c];
    STAGE(k2)
    EACH z[c] = y[c] + h * (3. / 40 * k1[c] + 9. / 40 * k2[c]);
    STAGE(k3)
    EACH z[c] = y[c] + h * (44. / 45 * k1[c] - 56. / 15 * k2[c] + 32. / 9 * k3[c]);
    STAGE(k4)
    EACH z[c] = y[c] + h * (19372. / 6561 * k1[c] - 25360. / 2187 * k2[c] + 64448. / 6561 * k3[c]
                            - 212. / 729 * k4[c]);
    STAGE(k5)
    EACH z[c] = y[c] + h * (9017. / 3168 * k1[c] - 355. / 33 * k2[c] + 46732. / 5247 * k3[c]
                            + 49. / 176 * k4[c] - 5103. / 18656 * k5[c]);
    STAGE(k6)
    EACH z[c] = y[c] + h * (35. / 384 * k1[c] + 500. / 1113 * k3[c] + 125. / 192 * k4[c]
                            - 2187. / 6784 * k5[c] + 11. / 84 * k6[c]);
    STAGE(k7)
    double worst = 0, sum = 0;
    EACH {
      const double w = fabs(h * (71. / 57600 * k1[c] - 71. / 16695 * k3[c] + 71. / 1920 * k4[c]
                                 - 17253. / 339200 * k5[c] + 22. / 525 * k6[c] - 1. / 40 * k7[c]));
      sum += w;
      worst = w > worst ? w : worst;
    }
    const double error = sum < INFINITY ? worst / tol : 1e9; /* also where it is not a number */
    if (error <= 1.0) {
      t = t + h >= end ? end : t + h;
      memcpy(y, z, N * sizeof(double));
      memcpy(k1, k7, N * sizeof(double));
      steps++;
    } else (*rejected)++;
    const double grow = 0.9 * pow(error > 1e-10 ? error : 1e-10, -0.2);
    h *= grow > 5 ? 5 : grow > 0.2 ? grow : 0.2;
  }
  free(block);
  return steps;
}
"""


@functools.cache
def _bare_library() -> ctypes.CDLL:
    compiler = shutil.which("gcc")
    if compiler is None:
        raise Missing("gcc is not installed")
    folder = Path(tempfile.mkdtemp(prefix="bare-loop-"))
    (folder / "bare.c").write_text(BARE)
    # Fused multiply-adds would treat x and y differently, and this net amplifies that 1e11 times until 1.5 s.
    command = [
        compiler,
        "-O3",
        "-march=native",
        "-ffp-contract=off",
        "-shared",
        "-fPIC",
        "bare.c",
        "-o",
        "bare.so",
        "-lm",
    ]
    subprocess.run(command, cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "bare.so"))
    shutil.rmtree(folder)
    library.march.restype = ctypes.c_long
    return library


def bare(problem: Problem, tolerance: float) -> Outcome:
    """A bare loop in C on one core: the force and Dormand-Prince steps; setting: tolerance [m, m/s]."""
    march = _bare_library().march
    n, m = len(problem.mass), len(problem.length)
    ends = np.ascontiguousarray(np.stack([problem.first, problem.second], axis=1), dtype=np.int32)
    square, factor = problem.length**2, problem.stiffness / (2.0 * problem.length**3)
    inverse = np.repeat(1.0 / problem.mass, 3)
    y = np.concatenate([problem.position.ravel(), problem.velocity.ravel()])
    rejected = ctypes.c_long(0)
    real = ctypes.c_double
    longest = real(problem.longest_step)
    pointers = [ctypes.c_void_p(a.ctypes.data) for a in (ends, square, factor, inverse, y)]
    began = time.perf_counter()
    march(n, m, *pointers, real(problem.end), real(tolerance), real(1e-5), longest, ctypes.byref(rejected))
    return time.perf_counter() - began, problem.speeds(y[3 * n :])
