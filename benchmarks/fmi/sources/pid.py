"""The PID controller of the Jeffcott rotor as an FMU of another tool: Python inside, by pythonfmu (FMI 2.0, CS).

Build Pid.fmu in this folder: ``pip install pythonfmu setuptools && pythonfmu build -f pid.py``
"""

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class Pid(Fmi2Slave):
    """i = KP u + KI int u dt + KD u' on each axis; the integral by Euler's method, inputs held over a step."""

    author = "rotorsim"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.KP, self.KI, self.KD = 12200.0, 2000.0, 3.0  # A/m, A/(m s), A s/m; thesis Table 2-1
        self.x = self.y = self.vx = self.vy = 0.0  # m, m/s
        self.ix = self.iy = 0.0  # A
        self.sum_x = self.sum_y = 0.0  # m s
        for name in ("KP", "KI", "KD"):
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        for name in ("x", "y", "vx", "vy"):
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        for name in ("ix", "iy"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        self.sum_x += self.x * step_size
        self.sum_y += self.y * step_size
        self.ix = self.KP * self.x + self.KI * self.sum_x + self.KD * self.vx
        self.iy = self.KP * self.y + self.KI * self.sum_y + self.KD * self.vy
        return True
