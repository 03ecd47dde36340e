"""Matrices of a beam element, and a banded solver; plain arithmetic on numbers or CasADi symbols.

Degrees of freedom of one plane: [u_1, slope_1, u_2, slope_2]. Entries are plain Python lists.
Source: Friswell, Penny, Garvey & Lees, Dynamics of Rotating Machines (2010), sec. 5.4;
thesis Appendix B is the case without shear and rotary inertia.
"""

from collections.abc import Callable, Iterable, Sequence
from math import sqrt
from typing import Any

Table = list[list[Any]]
BAND = 3  # off-diagonals of a chain of beam elements in one plane
_MINOR, _MAJOR = (sqrt(5 - s * 2 * sqrt(10 / 7)) / 6 for s in (1, -1))
_WEIGHTS = [(322 + s * 13 * sqrt(70)) / 1800 for s in (1, -1)]
GAUSS = [  # points and weights on [0, 1], exact for polynomials of degree 9
    (0.5 - _MAJOR, _WEIGHTS[1]),
    (0.5 - _MINOR, _WEIGHTS[0]),
    (0.5, 64 / 225),
    (0.5 + _MINOR, _WEIGHTS[0]),
    (0.5 + _MAJOR, _WEIGHTS[1]),
]


def entry(values: Any, k: int) -> Any:
    """Return entry k of a parameter that has one for each element or disc, or one for all."""
    return values[k] if values.shape[0] > 1 else values


def each(values: Iterable[Any], count: int) -> list[tuple[Any, ...]]:
    """Return for each element or disc its entries of several parameters."""
    every = list(values)
    return [tuple(entry(one, k) for one in every) for k in range(count)]


def shear_coefficient(poisson_ratio: Any, inner: Any, outer: Any) -> Any:
    """Return kappa of a hollow circular section (Cowper 1966, table 1)."""
    m2 = (inner / outer) ** 2
    nu, full = poisson_ratio, (1 + m2) ** 2
    return 6 * (1 + nu) * full / ((7 + 6 * nu) * full + (20 + 12 * nu) * m2)


def stiffness(ei: Any, length: Any, phi: Any) -> Table:
    """Return the stiffness matrix; phi = 12 E I / (kappa G A l^2), zero for Euler-Bernoulli."""
    k = ei / ((1 + phi) * length**3)
    a, b = 12 * k, 6 * length * k
    c, d = (4 + phi) * length**2 * k, (2 - phi) * length**2 * k
    return [[a, b, -a, b], [b, c, -b, d], [-a, -b, a, -b], [b, d, -b, c]]


def translation_mass(mass: Any, length: Any, phi: Any) -> Table:
    """Return the consistent mass matrix of translation; mass = rho A l."""
    k = mass / (840 * (1 + phi) ** 2)
    m1 = (312 + 588 * phi + 280 * phi**2) * k
    m2 = (44 + 77 * phi + 35 * phi**2) * length * k
    m3 = (108 + 252 * phi + 140 * phi**2) * k
    m4 = -(26 + 63 * phi + 35 * phi**2) * length * k
    m5 = (8 + 14 * phi + 7 * phi**2) * length**2 * k
    m6 = -(6 + 14 * phi + 7 * phi**2) * length**2 * k
    return [[m1, m2, m3, m4], [m2, m5, -m4, m6], [m3, -m4, m1, -m2], [m4, m6, -m2, m5]]


def rotary_mass(rho_i: Any, length: Any, phi: Any) -> Table:
    """Return the consistent mass matrix of rotary inertia; rho_i = rho I. Twice it is the gyroscopic matrix."""
    k = rho_i / (30 * (1 + phi) ** 2 * length)
    m7, m8 = 36 * k, (3 - 15 * phi) * length * k
    m9 = (4 + 5 * phi + 10 * phi**2) * length**2 * k
    m10 = (-1 - 5 * phi + 5 * phi**2) * length**2 * k
    return [[m7, m8, -m7, m8], [m8, m9, -m8, m10], [-m7, -m8, m7, -m8], [m8, m10, -m8, m9]]


def shapes(length: Any, phi: Any, distance: Any) -> tuple[list[Any], list[Any]]:
    """Return the rows by which the ends give displacement and slope at a distance from the first end.

    They are exact for a beam loaded at its ends only, and those of the mass matrices above.
    """
    xi, f = distance / length, 1 / (1 + phi)
    half = phi / 2 * (xi - xi**2)
    across = [
        f * (1 - 3 * xi**2 + 2 * xi**3 + phi * (1 - xi)),
        f * length * (xi - 2 * xi**2 + xi**3 + half),
        f * (3 * xi**2 - 2 * xi**3 + phi * xi),
        f * length * (-(xi**2) + xi**3 - half),
    ]
    bend = 6 * f / length * (xi - xi**2)
    slope = [-bend, f * (1 - 4 * xi + 3 * xi**2 + phi * (1 - xi)), bend, f * (-2 * xi + 3 * xi**2 + phi * xi)]
    return across, slope


def conical(
    modulus: Any,
    density: Any,
    length: Any,
    phi: Any,
    middle: tuple[Any, Any],
    section: Callable[[float], tuple[Any, Any]],
) -> tuple[Table, Table, Table]:
    """Return stiffness, mass of translation and mass of rotary inertia of an element whose section varies.

    K = int E I N_k'^T N_k' + kappa G A g^T g dz,   M = int rho A N_u^T N_u dz,   R = int rho I N_k^T N_k dz

    by the strain and kinetic energy of Timoshenko's beam with the displacement N_u q, the slope N_k q and the shear
    strain g q of a cylinder with the phi of the middle. section: area A and second moment I at a fraction of the
    length: of a cone polynomials of degree 2 and 4, so that the quadrature is exact; middle: those in the middle.
    Shapes of a cylinder are too stiff for a cone: its static bending is exact but for the fourth power of the length of
    the elements, its shear but for the square.
    Source: Friswell et al. (2010), sec. 5.4 (energies); Genta & Gugliotta, J. Sound Vib. 120 (1988) 175 (cones).
    """
    tables: tuple[Table, Table, Table] = tuple([[0.0] * 4 for _ in range(4)] for _ in range(3))
    f, (area_m, second_m) = 1 / (1 + phi), middle
    shear = [-f * phi / length, -f * phi / 2, f * phi / length, -f * phi / 2]
    for xi, weight in GAUSS:
        area, second = section(xi)
        across, slope = shapes(length, phi, xi * length)
        bend = 6 * f / length**2 * (1 - 2 * xi)
        curvature = [-bend, f / length * (6 * xi - 4 - phi), bend, f / length * (6 * xi - 2 + phi)]
        # kappa G A = 12 E I / (phi l^2) in the middle, in proportion to the area elsewhere; phi^2 is in the shapes
        slip = 0.0 if _is_zero(phi) else 12 * modulus * second_m / (phi * length**2) * area / area_m
        for i in range(4):
            for j in range(4):
                strain = modulus * second * curvature[i] * curvature[j] + slip * shear[i] * shear[j]
                parts = strain, density * area * across[i] * across[j], density * second * slope[i] * slope[j]
                for table, part in zip(tables, parts, strict=True):
                    table[i][j] = table[i][j] + weight * length * part
    return tables


class Banded:
    """A symmetric matrix of `BAND` off-diagonals: rows[i][k] is entry (i, i - k)."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.rows: Table = [[0.0] * (min(i, BAND) + 1) for i in range(size)]

    def add(self, i: int, j: int, value: Any) -> None:
        """Add to entry (i, j) and (j, i); entries above the diagonal are ignored."""
        if i >= j:
            self.rows[i][i - j] = self.rows[i][i - j] + value

    def scaled(self, factor: Any) -> "Banded":
        """Return the matrix times a number."""
        return self._mapped(lambda i, k: self.rows[i][k] if _is_zero(self.rows[i][k]) else factor * self.rows[i][k])

    def plus(self, other: "Banded") -> "Banded":
        """Return the sum with a matrix of the same size."""
        return self._mapped(lambda i, k: self.rows[i][k] + other.rows[i][k])

    def _mapped(self, entry_at: Callable[[int, int], Any]) -> "Banded":
        made = Banded(self.size)
        made.rows = [[entry_at(i, k) for k in range(len(row))] for i, row in enumerate(self.rows)]
        return made

    def times(self, v: Sequence[Any]) -> list[Any]:
        """Return the product with a vector."""

        def entries(i: int) -> list[tuple[Any, int]]:
            near = range(max(i - BAND, 0), min(i + BAND, self.size - 1) + 1)
            row = [(self.rows[max(i, j)][abs(i - j)], j) for j in near]
            return [(entry, j) for entry, j in row if not _is_zero(entry)]

        return [sum((entry * v[j] for entry, j in entries(i)), 0.0) for i in range(self.size)]

    def factor(self) -> tuple[Table, list[Any]]:
        """Return L (unit lower, rows as here without the diagonal) and the reciprocals of D of L D L^T."""
        lower: Table = []
        d: list[Any] = []
        for i in range(self.size):
            raw: dict[int, Any] = {}
            for j in range(max(i - BAND, 0), i):
                value = self.rows[i][i - j]
                for k in range(max(i - BAND, 0), j):
                    if j - k <= BAND:
                        value = value - raw[k] * lower[j][j - k - 1]
                raw[j] = value
            row = [raw[i - k] / d[i - k] for k in range(1, min(i, BAND) + 1)]
            diagonal = self.rows[i][0]
            for k, entry in enumerate(row, 1):
                diagonal = diagonal - entry * raw[i - k]
            lower.append(row)
            d.append(diagonal)
        return lower, [1 / value for value in d]


def solve_factored(lower: Table, inverse_d: Sequence[Any], b: Sequence[Any]) -> list[Any]:
    """Return the solution of L D L^T y = b in O(size) operations."""
    y = list(b)
    for i, row in enumerate(lower):
        for k, entry in enumerate(row, 1):
            y[i] = y[i] - entry * y[i - k]
    y = [value * inverse for value, inverse in zip(y, inverse_d, strict=True)]
    for i in reversed(range(len(y))):
        for k, entry in enumerate(lower[i], 1):
            y[i - k] = y[i - k] - entry * y[i]
    return y


def _is_zero(value: Any) -> bool:
    return isinstance(value, float) and value == 0.0
