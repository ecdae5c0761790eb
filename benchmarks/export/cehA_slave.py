"""The C-EHA as one would write it for PythonFMU: plain Python, Runge-Kutta of order 4, one internal step per step.

Parameters in the order of tests/simulation/flat_cehA.py, as in benchmarks/simulation/hand_written.c.
"""

from math import cos, exp, sin, sqrt, tanh

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

OUTPUTS = ("arm_angle", "motor_speed", "rod_position", "pressure_cap", "pressure_rod", "piston_force")


class CehASlave(Fmi2Slave):
    """Input: command [V]; parameters p_0 ... p_18 and start states x_0 ... x_4 in SI."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.command = 0.0
        self.register_variable(Real("command", causality=Fmi2Causality.input))
        for name in (*(f"p_{k}" for k in range(19)), *(f"x_{k}" for k in range(5))):
            setattr(self, name, 1.0)
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        for name in OUTPUTS:
            setattr(self, name, 0.0)
            self.register_variable(Real(name, causality=Fmi2Causality.output))

    def exit_initialization_mode(self):
        """Take the parameters and the start."""
        p = [getattr(self, f"p_{k}") for k in range(19)]
        self.state = [getattr(self, f"x_{k}") for k in range(5)]
        (self.gain, self.lag, self.displacement, self.cap_area, self.rod_area, self.cap_volume, self.rod_volume,
         self.bulk, self.kinetic, self.static, self.viscous, self.stribeck, self.smooth) = p[:13]  # fmt: skip
        payload, beam, length, self.pin, self.distance, self.retracted = p[13:]
        self.inertia = payload * length**2 + beam * length**2 / 3
        self.moment = (payload + beam / 2) * 9.80665 * length
        self.ratio = self.rod_area / self.cap_area

    def do_step(self, current_time, step_size):
        """One step with the input held."""
        x, u, h, rate = self.state, self.command, step_size, self.rate
        k1 = rate(x, u)
        k2 = rate([a + h / 2 * b for a, b in zip(x, k1, strict=True)], u)
        k3 = rate([a + h / 2 * b for a, b in zip(x, k2, strict=True)], u)
        k4 = rate([a + h * b for a, b in zip(x, k3, strict=True)], u)
        self.state = x = [a + h / 6 * (b + 2 * c + 2 * d + e) for a, b, c, d, e in zip(x, k1, k2, k3, k4, strict=True)]
        self.motor_speed, self.pressure_cap, self.pressure_rod, self.arm_angle, _ = x
        pin, distance = self.pin, self.distance
        self.rod_position = sqrt(pin**2 + distance**2 + 2 * pin * distance * sin(x[3])) - self.retracted
        self.piston_force = x[1] * self.cap_area - x[2] * self.rod_area
        return True

    def rate(self, x, u):
        """Derivatives of speed, cap pressure, rod pressure, angle and angular speed."""
        speed, cap, rod, angle, turning = x
        c, pin, distance = cos(angle), self.pin, self.distance
        span = sqrt(pin * pin + distance * distance + 2 * pin * distance * sin(angle))
        lever, stroke, flow = pin * distance * c / span, span - self.retracted, self.displacement * speed
        v = lever * turning
        z = v / self.stribeck
        friction = (self.kinetic + (self.static - self.kinetic) * exp(-z * z)) * tanh(v / self.smooth)
        friction += self.viscous * v
        force = cap * self.cap_area - rod * self.rod_area - friction
        return (
            (self.gain * u - speed) / self.lag,
            self.bulk / (self.cap_volume + self.cap_area * stroke) * (flow - self.cap_area * v),
            self.bulk / (self.rod_volume - self.rod_area * stroke) * (self.rod_area * v - flow * self.ratio),
            turning,
            (lever * force - self.moment * c) / self.inertia,
        )
