"""A signal that arrives late, anywhere in a model: a filter that agrees with a delay as far as recordings show."""

from __future__ import annotations

import math

import casadi as ca

from hydrotwin.models.language import Input, Output, Parameter, State, der

from .stepping import Lagged

PADE = (1.0, 1 / 2, 3 / 28, 1 / 84, 1 / 1680)  # of the denominator of Pade's (4,4) form of exp(-s)


class Late(Lagged):
    """``y(t) = u(t - T)``, as a filter of fourth order that agrees with it to (s T)^4.

        z_k = T_e^k v^(k),   z_0 + c_1 z_1 + ... + c_4 z_4 = u,   T_e = sqrt(T^2 + T_0^2),   r = T / T_e
        y = u + sum_k m_k z_k,   m_k = sum_{j=1..k} c_(k-j) (-r)^j / j!,   c = 1, 1/2, 3/28, 1/84, 1/1680

    For T well above T_0 that is Pade's (4,4) form, 0.06 % off at w T = 3 and 12 % at w T = 6; for T = 0 it is y = u,
    with no faster state than 6.8 / T_0. It is taken to stand still at the start.
    Source: G. A. Baker and P. Graves-Morris, Pade Approximants, 1996.
    """

    shortest = 4.0

    u = Input("signal", "what comes in")
    y = Output("signal", "what goes on, late")
    late = State(lambda part: 0.0, "signal", "v", fixed=False)
    late_1 = State(0.0, "signal", "T_e v'")
    late_2 = State(0.0, "signal", "T_e^2 v^(2)")
    late_3 = State(0.0, "signal", "T_e^3 v^(3)")
    time = Parameter(0.0, "s", "delay T", bounds=(0, 0.5), nominal=0.01, source="bus and filter", free=True)
    resolution = Parameter(4e-3, "s", "T_0", bounds=(1e-4, 0.1), source="numerical")

    def equations(self):
        T_e = ca.sqrt(self.time**2 + self.resolution**2)
        z = [self.late, self.late_1, self.late_2, self.late_3]
        z.append((self.u - sum(c * part for c, part in zip(PADE, z, strict=False))) / PADE[4])
        for k in range(4):
            yield der(z[k]) == z[k + 1] / T_e
        terms = [(-self.time / T_e) ** j / math.factorial(j) for j in range(5)]
        shares = [sum(PADE[k - j] * terms[j] for j in range(1, k + 1)) for k in range(1, 5)]
        yield self.y == self.u + sum(m * part for m, part in zip(shares, z[1:], strict=True))

    def initial_equations(self):
        yield self.late == self.u
