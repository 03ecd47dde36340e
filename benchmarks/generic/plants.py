"""The plants of equations.c: what of their diagrams is which parameter, place, channel and input; where what may be."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from benchmarks.generic.native import HERE

DIAGRAMS = HERE / "diagrams"


@dataclass(frozen=True)
class Input:
    """What drives a run: held or linear between samples, about a mean, up to a frequency [Hz]; rest: before it."""

    name: str
    signal: str
    unit: str
    mean: float
    amplitude: float
    top: float
    linear: bool = False
    rest: float = 0.0


@dataclass(frozen=True)
class Plant:
    """A plant and its loop.

    parameters: where they are in the diagram, in the order of equations.c; places: likewise, as ports: an output is
    what all that it goes to sees, an input is one wire. channels: name, signal, unit. pace [s]: of what is fastest
    among what matters. effects: law and place, and the place of its argument, as `law place argument`.
    """

    name: str
    number: int
    parameters: tuple[str, ...]
    places: tuple[tuple[str, str], ...]
    channels: tuple[tuple[str, str, str], ...]
    inputs: tuple[Input, ...]
    rate: float
    pace: float
    states: int
    effects: tuple[str, ...]
    initial: tuple[str, ...] = ()  # states that do not start at zero: where the diagram says so

    @property
    def file(self) -> Path:
        """Return where the diagram is."""
        return DIAGRAMS / f"{self.name}.json"

    @cached_property
    def document(self) -> dict[str, Any]:
        """Return the diagram as data."""
        document: dict[str, Any] = json.loads(self.file.read_text())
        return document

    def written(self, where: str) -> float:
        """Return a number of the diagram: block.parameter, entries counted from 1."""
        block, _, key = where.partition(".")
        name, _, entry = key.partition("[")
        value = self.document["blocks"][block]["parameters"][name]
        value = value[int(entry[:-1]) - 1] if entry else value
        if isinstance(value, str):  # "20 ms"
            number, _, unit = value.partition(" ")
            return float(number) * {"s": 1.0, "ms": 1e-3}[unit]
        return float(value)

    @property
    def free(self) -> tuple[str, ...]:
        """Return the parameters that the diagram leaves free."""
        return tuple(self.document["identify"])

    @property
    def start(self) -> tuple[float, ...]:
        """Return the states at the start."""
        return tuple(map(self.written, self.initial)) or (0.0,) * self.states

    def place(self, name: str) -> int:
        """Return the number of a place."""
        return [short for short, _ in self.places].index(name)


def _pairs(text: str) -> tuple[tuple[str, str], ...]:
    """Return `NAME port` of each line."""
    return tuple((line.split()[0], line.split()[1]) for line in text.strip().splitlines())


def _lines(text: str) -> tuple[str, ...]:
    return tuple(
        " ".join(line.split()) for part in text.strip().splitlines() for line in part.split(",") if line.strip()
    )


PLANTS = {
    plant.name: plant
    for plant in (
        Plant(
            "two_tanks", 0,
            ("pump.gain", "outlet1.gain", "outlet2.gain", "inverse_area1.gain", "inverse_area2.gain"),
            _pairs("""
                DRIVE pump.input
                INFLOW pump.output
                HEAD1 root1.input
                OUTFLOW1 outlet1.output
                NET1 balance1.output
                HEAD2 root2.input
                OUTFLOW2 outlet2.output
                NET2 balance2.output
                READ1 level1_sensor.output
                READ2 level2_sensor.output
            """),
            (("level1", "level1_sensor.output", "m"), ("level2", "level2_sensor.output", "m")),
            (Input("pump", "pump_voltage.output", "V", 5.0, 2.8, 0.02, rest=5.0),),
            1.0, 80.0, 2,
            _lines("""
                saturation DRIVE, dead_zone DRIVE, play DRIVE, rate_limit DRIVE, quadratic INFLOW, cubic DRIVE
                delay INFLOW, lag INFLOW, lag READ1, leak NET1 READ1, drift READ1, jump READ2, offset READ2
                quantisation READ2, line NET2, series NET1, cross_talk READ2 READ1, gain_drift OUTFLOW1
                gain_schedule INFLOW READ1, prandtl DRIVE, fractional INFLOW, fractional READ2, self_heating INFLOW
            """),
            ("level1.initial", "level2.initial"),
        ),
        Plant(
            "heated_chamber", 1,
            ("inverse_heater_capacity.gain", "conductance.gain", "inverse_chamber_capacity.gain", "loss.gain",
             "proportional.gain", "integral_gain.gain"),
            _pairs("""
                SENSED1 heater_thermometer.output
                SENSED2 chamber_thermometer.output
                ERROR error.output
                INTEGRAND integral.input
                INTEGRAL integral.output
                POWER heater_balance.input1
                HEATER heater.output
                HEAT conductance.output
                CHAMBER chamber.output
                NET chamber_balance.output
                LOSS loss.output
            """),
            (("power", "controller.output", "W"), ("heater", "heater_thermometer.output", "K"),
             ("chamber", "chamber_thermometer.output", "K")),
            (Input("setpoint", "setpoint.output", "K", 0.0, 8.0, 0.02),
             Input("room", "room.output", "K", 0.0, 3.0, 0.004, linear=True)),
            1.0, 60.0, 3,
            _lines("""
                saturation POWER, dead_zone POWER, play POWER, asymmetry POWER, rate_limit POWER, lag POWER, delay POWER
                delay SENSED2, lag SENSED2, lag SENSED1, cubic HEAT, quadratic HEAT, leak INTEGRAND INTEGRAL
                offset SENSED1, drift SENSED2, jump SENSED2, series NET, line NET, cross_talk SENSED2 HEATER
                gain_drift POWER, gain_schedule HEAT CHAMBER, quantisation SENSED1, mode POWER
                fractional POWER, fractional SENSED2, prandtl POWER, self_heating POWER
            """),
        ),
        Plant(
            "buck_converter", 2,
            ("inverse_inductance.gain", "coil_resistance.gain", "inverse_capacitance.gain", "load.gain",
             "proportional.gain", "integral_gain.gain"),
            _pairs("""
                CURRENT coil_current.output
                VOLTAGE capacitor_voltage.output
                SENSED_I current_probe.output
                SENSED_V voltage_divider.output
                INTEGRAL integral.output
                INTEGRAND integral.input
                DUTY switch_node.input1
                SWITCHED switch_node.output
                DROP coil_resistance.output
                NET_V coil_voltage.output
                LOAD load.output
                NET_I capacitor_current.output
            """),
            (("duty", "controller.output", "1"), ("current", "current_probe.output", "A"),
             ("voltage", "voltage_divider.output", "V")),
            (Input("reference", "reference.output", "V", 6.0, 3.0, 600.0),
             Input("source", "source.output", "V", 24.0, 2.0, 150.0, linear=True, rest=24.0)),
            20e3, 4e-4, 3,
            _lines("""
                saturation DUTY, dead_zone SWITCHED, cubic LOAD, delay DUTY, lag SENSED_V, lag DUTY
                mode SENSED_V, mode DUTY, rate_limit DUTY, leak INTEGRAND INTEGRAL, offset SENSED_I, offset SENSED_V
                drift SENSED_I, jump SENSED_V, series NET_I, line NET_I, cross_talk SENSED_V CURRENT, gain_drift LOAD
                gain_schedule SWITCHED CURRENT, quantisation SENSED_I
                fractional NET_V, fractional DUTY, prandtl DUTY, self_heating DROP
            """),
        ),
        Plant(
            "hydraulic_cylinder", 3,
            ("flow_gain.gain", "stiffness.gain", "leakage.gain", "inverse_mass.gain", "viscous.gain", "area.gain",
             "controller.gain", "valve.denominator[1]"),
            _pairs("""
                PRESSURE load_pressure.output
                SPEED velocity.output
                POSITION position.output
                SENSED_P pressure_sensor.output
                SENSED_Z position_sensor.output
                COMMAND valve.input
                SPOOL flow_gain.input
                FLOW flow_gain.output
                LEAKAGE leakage.output
                NET_Q flow.output
                PUSH area.output
                DRAG viscous.output
                NET_F net_force.output
            """),
            (("command", "controller.output", "V"), ("pressure", "pressure_sensor.output", "Pa"),
             ("position", "position_sensor.output", "m")),
            (Input("reference", "reference.output", "m", 0.0, 0.02, 25.0),),
            1000.0, 0.03, 4,
            _lines("""
                saturation COMMAND, dead_zone SPOOL, play COMMAND, friction NET_F SPEED, cubic SPOOL, asymmetry SPOOL
                stop NET_F POSITION, delay COMMAND, rate_limit COMMAND, lag SENSED_P, mode COMMAND, mode SENSED_Z
                offset SENSED_P, drift SENSED_P, jump SENSED_Z, line NET_F, series NET_F, cross_talk SENSED_P SPEED
                gain_drift FLOW, gain_schedule FLOW PRESSURE, quantisation SENSED_P, quadratic PUSH
                bouc_wen NET_F SPEED, fractional COMMAND, prandtl COMMAND, self_heating DRAG, ripple NET_F POSITION
            """),
        ),
        Plant(
            "crane", 4,
            ("inverse_mass.gain", "trolley_friction.gain", "load_weight.gain", "inverse_length.gain",
             "swing_damping.gain", "proportional.gain", "velocity_gain.gain", "gravity.gain"),
            _pairs("""
                SPEED trolley_speed.output
                TROLLEY trolley.output
                RATE swing_rate.output
                SWING swing.output
                SENSED_X distance_sensor.output
                SENSED_A angle_sensor.output
                ERROR error.output
                FEEDBACK velocity_gain.output
                FORCE trolley_force.input1
                DRAG trolley_friction.output
                PULL load_weight.output
                NET trolley_force.output
                NET_SWING swing_acceleration.output
            """),
            (("force", "controller.output", "N"), ("distance", "distance_sensor.output", "m"),
             ("angle", "angle_sensor.output", "rad")),
            (Input("reference", "reference.output", "m", 0.0, 0.3, 1.5),),
            100.0, 0.3, 4,
            _lines("""
                saturation FORCE, dead_zone FORCE, play FORCE, friction NET SPEED, quadratic FORCE, asymmetry FORCE
                stop NET TROLLEY, delay FORCE, delay SENSED_X, rate_limit FORCE, lag FORCE, lag SENSED_A, mode SENSED_A
                mode FORCE, offset SENSED_A, jump SENSED_X, line NET_SWING, series NET_SWING
                cross_talk SENSED_A TROLLEY, gain_drift DRAG, gain_schedule DRAG TROLLEY, quantisation SENSED_A
                bouc_wen NET SPEED, fractional FORCE, fractional SENSED_A, prandtl FORCE
                self_heating FORCE, ripple NET TROLLEY
            """),
        ),
        Plant(
            "belt_drive", 5,
            ("inverse_carriage_mass.gain", "belt_stiffness.gain", "belt_damping.gain", "inverse_load_mass.gain",
             "load_friction.gain", "carriage_friction.gain"),
            _pairs("""
                SPEED1 carriage_speed.output
                SPEED2 load_speed.output
                SENSED1 carriage_tacho.output
                SENSED2 load_tacho.output
                FORCE carriage_force.input1
                DRAG1 carriage_friction.output
                STRETCH stretch.output
                SPRING belt_stiffness.output
                DAMPING belt_damping.output
                BELT belt_force.output
                DRAG2 load_friction.output
                NET1 carriage_force.output
                NET2 load_force.output
            """),
            (("carriage", "carriage_tacho.output", "m/s"), ("load", "load_tacho.output", "m/s")),
            (Input("force", "force.output", "N", 0.0, 60.0, 30.0),),
            500.0, 0.02, 3,
            _lines("""
                dead_zone STRETCH, play FORCE, friction NET2 SPEED2, friction NET1 SPEED1, cubic SPRING
                asymmetry SPRING, stop BELT STRETCH, saturation FORCE, delay FORCE, rate_limit FORCE, lag FORCE
                lag SENSED2, mode FORCE, mode SENSED2, offset SENSED1, drift SENSED2, jump SENSED1, line NET2
                series NET2, cross_talk SENSED2 SPEED1, gain_drift DRAG2, gain_schedule FORCE SPEED1
                quantisation SENSED1, cubic FORCE, quadratic FORCE
                bouc_wen NET2 SPEED2, fractional BELT, fractional FORCE, prandtl FORCE, self_heating DAMPING
            """),
        ),
        Plant(
            "generator", 6,
            ("inverse_field_inductance.gain", "field_resistance.gain", "flux.gain", "inverse_armature_inductance.gain",
             "load.gain", "armature_resistance.gain", "proportional.gain", "integral_gain.gain"),
            _pairs("""
                FIELD field_current.output
                ARMATURE armature_current.output
                SENSED_I ammeter.output
                SENSED_V voltmeter.output
                ERROR error.output
                INTEGRAL integral.output
                INTEGRAND integral.input
                EXCITER field_balance.input1
                DROP field_resistance.output
                NET_FIELD field_balance.output
                FLUX flux.output
                EMF emf.output
                NET_ARM armature_balance.output
            """),
            (("field_voltage", "controller.output", "V"), ("field_current", "ammeter.output", "A"),
             ("voltage", "voltmeter.output", "V")),
            (Input("reference", "reference.output", "V", 100.0, 30.0, 20.0),
             Input("speed", "speed.output", "rad/s", 150.0, 20.0, 1.0, linear=True, rest=150.0)),
            1000.0, 0.05, 3,
            _lines("""
                saturation EXCITER, cubic FLUX, dead_zone EXCITER, play EXCITER, delay EXCITER, delay SENSED_V
                lag SENSED_V, lag EXCITER, mode EXCITER, rate_limit EXCITER, leak INTEGRAND INTEGRAL, offset SENSED_I
                drift SENSED_V, jump SENSED_V, line EMF, series EMF
                mode SENSED_V, gain_drift DROP, gain_schedule FLUX ARMATURE, quantisation SENSED_I
                quadratic FLUX, prandtl FLUX, fractional FLUX, fractional EXCITER, self_heating DROP
            """),
        ),
        Plant(
            "ball_and_beam", 7,
            ("servo.denominator[1]", "rolling.gain", "resistance.gain", "proportional.gain", "derivative_gain.gain",
             "derivative.time_constant"),
            _pairs("""
                ANGLE servo.output
                SPEED ball_speed.output
                BALL ball.output
                SENSED_A angle_sensor.output
                CAMERA camera.output
                ERROR error.output
                COMMAND servo.input
                SLOPE slope.input
                PULL rolling.output
                DRAG resistance.output
                NET ball_acceleration.output
            """),
            (("command", "controller.output", "rad"), ("angle", "angle_sensor.output", "rad"),
             ("position", "camera.output", "m")),
            (Input("reference", "reference.output", "m", 0.0, 0.2, 1.0),),
            100.0, 0.35, 4,
            _lines("""
                saturation COMMAND, dead_zone COMMAND, play SLOPE, friction NET SPEED, cubic SLOPE, stop NET BALL
                delay CAMERA, delay COMMAND, rate_limit COMMAND, lag CAMERA, mode COMMAND, mode CAMERA, offset SENSED_A
                drift SENSED_A, jump CAMERA, line NET, series NET, cross_talk SENSED_A BALL, gain_drift PULL
                gain_schedule PULL BALL, quantisation SENSED_A, asymmetry COMMAND, lag SENSED_A
                bouc_wen NET SPEED, fractional COMMAND, fractional CAMERA, prandtl SLOPE, ripple NET BALL
            """),
        ),
    )
}  # fmt: skip
