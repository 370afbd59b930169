"""The same least squares with scipy at its best: Levenberg-Marquardt of MINPACK with the analytic
Jacobian, model and Jacobian vectorised over all measurements, what does not change from step to step
made once, the Jacobian written in place; the pose that residuals and Jacobian share is kept. BLAS on
one and on all threads, unknowns unscaled and scaled by the Jacobian: the fastest of all counts.

Argument: file (length, its u, noise, balls; then per measurement B C S X Y Z ball).
Prints seconds, then thirteen errors, the stylus and the balls.
"""

import sys
import time

import numpy as np
from scipy.optimize import least_squares

NOMINAL_TOOL = np.array([0.0, 0.0, -326.717])
# EA0B EC0B EX0C EA0C EB0C EB0Z EA0Y EC0Y EY0S EX0S EXX1 EYY1 EZZ1


def rot(axis, angle):
    """Rotations about X, Y or Z, of one angle or of many."""
    c, s = np.cos(angle), np.sin(angle)
    r = np.zeros(np.shape(angle) + (3, 3))
    i, j, k = axis, (axis + 1) % 3, (axis + 2) % 3
    r[..., i, i] = 1.0
    r[..., j, j] = r[..., k, k] = c
    r[..., j, k], r[..., k, j] = -s, s
    return r


class Problem:
    def __init__(self, file):
        with open(file) as lines:
            length, u_bar, noise, balls = next(lines).split()
            table = np.loadtxt(lines)
        self.length, self.u_bar, self.noise = float(length), float(u_bar), float(noise)
        self.balls, self.n = int(balls), len(table)
        angles, self.xyz, self.ball = table[:, :3], table[:, 3:6], table[:, 6].astype(int)
        # The rotations are those of 24 indexations, not of 613 measurements.
        self.places, self.place = np.unique(angles, axis=0, return_inverse=True)
        self.place = self.place.ravel()
        self.rb, self.rc = rot(1, -self.places[:, 0]), rot(2, -self.places[:, 1])
        self.rs = rot(2, self.places[:, 2])
        # A nominal machine sees the residuals of a measurement in its own frame.
        self.weight = (self.rb @ self.rc)[self.place] / self.noise
        self.jac = np.zeros((3 * self.n + 1, 16 + 3 * self.balls))
        blocks = self.jac[:-1].reshape(self.n, 3, -1)
        for k in range(3):
            blocks[np.arange(self.n), :, 16 + 3 * self.ball + k] = -self.weight[:, :, k]
        self.key, self.pose = None, None

    def start(self):
        x = np.zeros(16 + 3 * self.balls)
        x[13:16] = NOMINAL_TOOL
        tips = self.at(x)["tip"]
        for ball in range(self.balls):
            x[16 + 3 * ball :][:3] = tips[self.ball == ball].mean(0)
        self.key = None
        return x

    def at(self, x):
        """Pose of everything at x, table frame; kept for the Jacobian."""
        key = x[:16].tobytes()
        if key == self.key:
            return self.pose
        ea0b, ec0b, ex0c, ea0c, eb0c, eb0z, ea0y, ec0y, ey0s, ex0s, exx, eyy, ezz = x[:13]
        rab, rcb = rot(0, ea0b), rot(2, ec0b)
        rac, rbc = rot(0, ea0c), rot(1, eb0c)
        rbz, ray, rcy = rot(1, eb0z), rot(0, ea0y), rot(2, ec0y)
        scaled = self.xyz * (1.0 + np.array([exx, eyy, ezz]))
        along = rbz @ ray @ rcy
        r_b = (rab @ rcb) @ self.rb
        r_w = r_b @ (rac @ rbc) @ self.rc
        stylus = self.rs @ x[13:16] + np.array([ex0s, ey0s, 0.0])
        in_y = scaled[:, 1:2] * along[:, 1] + (stylus @ along.T)[self.place]
        point = scaled[:, 2:3] * rbz[:, 2] + in_y
        point[:, 0] += scaled[:, 0]
        origin_c = r_b[:, :, 0] * ex0c
        in_w = point - origin_c[self.place]
        to_table = r_w.transpose(0, 2, 1)
        tip = np.einsum("nij,nj->ni", to_table[self.place], in_w)
        self.key = key
        self.pose = dict(
            tip=tip, point=point, in_w=in_w, in_y=in_y, to_table=to_table, r_b=r_b,
            rab=rab, rac=rac, rbz=rbz, ray=ray, along=along,
        )
        return self.pose

    def residuals(self, x):
        off = self.at(x)["tip"] - x[16:].reshape(-1, 3)[self.ball]
        r = np.empty(3 * self.n + 1)
        r[:-1] = np.einsum("nij,nj->ni", self.weight, off).ravel()
        r[-1] = (self.apart(x)[1] - self.length) / self.u_bar
        return r

    def apart(self, x):
        way = x[16 + 21 : 16 + 24] - x[16:19]
        return way, np.sqrt(way @ way)

    def jacobian(self, x):
        p = self.at(x)
        point, in_w, in_y = p["point"], p["in_w"], p["in_y"]
        r_b = p["r_b"]
        machine = np.empty((self.n, 3, 13))
        machine[:, :, 0] = -np.cross([1.0, 0.0, 0.0], point)
        machine[:, :, 1] = -np.cross(p["rab"][:, 2], point)
        machine[:, :, 2] = -r_b[:, :, 0][self.place]
        machine[:, :, 3] = -np.cross(r_b[:, :, 0][self.place], in_w)
        machine[:, :, 4] = -np.cross((r_b @ p["rac"][:, 1])[self.place], in_w)
        in_tool = point.copy()
        in_tool[:, 0] -= self.xyz[:, 0] * (1.0 + x[10])
        machine[:, :, 5] = np.cross([0.0, 1.0, 0.0], in_tool)
        machine[:, :, 6] = np.cross(p["rbz"][:, 0], in_y)
        machine[:, :, 7] = np.cross((p["rbz"] @ p["ray"])[:, 2], in_y)
        machine[:, :, 8] = p["along"][:, 1]
        machine[:, :, 9] = p["along"][:, 0]
        machine[:, :, 10] = 0.0
        machine[:, 0, 10] = self.xyz[:, 0]
        machine[:, :, 11] = self.xyz[:, 1:2] * p["along"][:, 1]
        machine[:, :, 12] = self.xyz[:, 2:3] * p["rbz"][:, 2]
        into = self.weight @ p["to_table"][self.place]
        blocks = self.jac[:-1].reshape(self.n, 3, -1)
        blocks[:, :, :13] = into @ machine
        blocks[:, :, 13:16] = into @ (p["along"] @ self.rs)[self.place]
        way, apart = self.apart(x)
        self.jac[-1, 16:19] = -way / apart / self.u_bar
        self.jac[-1, 16 + 21 : 16 + 24] = way / apart / self.u_bar
        return self.jac


def check(problem, x):
    """The analytic Jacobian against central differences."""
    x = x + 1e-5 * np.sin(np.arange(len(x)))
    found = problem.jacobian(x).copy()
    for j in range(16):
        h = 1e-4
        up, down = x.copy(), x.copy()
        up[j] += h
        down[j] -= h
        difference = (problem.residuals(up) - problem.residuals(down)) / (2 * h)
        worst = np.abs(difference - found[:, j]).max() / np.abs(difference).max()
        assert worst < 1e-6, (j, worst)


def main():
    problem = Problem(sys.argv[1])
    check(problem, problem.start())
    best, solution, told = np.inf, None, ""
    for scale in (1.0, "jac"):
        for _ in range(10):
            problem.key = None
            begin = time.perf_counter()
            found = least_squares(
                problem.residuals, problem.start(), jac=problem.jacobian, method="lm", x_scale=scale
            )
            seconds = time.perf_counter() - begin
            if seconds < best and found.success:
                best, solution = seconds, found.x
                told = f"x_scale {scale}, {found.nfev} evaluations, {found.njev} Jacobians"
    print(f"# numpy {np.__version__}: {told}")
    print(best)
    for value in solution:
        print(repr(float(value)))


main()
