"""A small reader of ISO 10303-21 text and a checker of the solids in it, which share no code with what is tested.

The checker looks at geometry as well as at references: a solid whose one plane is tilted passes many a kernel's test.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

TOLERANCE_MM = 4e-9
"""Coordinates have nine decimals, and so have directions: see `_tolerance_mm`."""
SPLINE_TOLERANCE_MM = 1e-7
"""What kernels take for one place."""
_SAMPLES = 12
_TOKEN = re.compile(
    r"\s*(?:(#\d+)|('(?:[^']|'')*')|(\.[A-Z_]+\.)|(-?\d+\.\d*(?:E[+-]?\d+)?|-?\d+)|([A-Z_][A-Z_0-9]*)|([(),$*;=]))"
)


@dataclass(frozen=True, slots=True)
class Ref:
    number: int


@dataclass(frozen=True, slots=True)
class Entity:
    """An entity's keyword and values; of a complex one the keyword is empty and the values are entities."""

    kind: str
    values: list[Any]


class StepFile:
    """All entities of a file by number; every one defined once, every one referred to defined."""

    def __init__(self, data: bytes) -> None:
        text = data.decode("ascii")
        assert text.startswith("ISO-10303-21;\nHEADER;\n")
        assert text.endswith("ENDSEC;\nEND-ISO-10303-21;\n")
        self.header, _, content = text[: -len("ENDSEC;\nEND-ISO-10303-21;\n")].partition("ENDSEC;\nDATA;\n")
        self.entities: dict[int, Entity] = {}
        self.used: Counter[int] = Counter()
        tokens = _tokens(content)
        for kind, token in tokens:
            assert kind == "ref", f"{token!r} where a name should stand"
            assert next(tokens)[1] == "="
            number = int(token[1:])
            assert number not in self.entities, f"#{number} is defined twice"
            self.entities[number] = self._entity(tokens)
        undefined = self.used.keys() - self.entities.keys()
        assert not undefined, f"{len(undefined)} names without an entity"

    def _entity(self, tokens: Iterator[tuple[str, str]]) -> Entity:
        kind, token = next(tokens)
        if kind == "word":
            assert next(tokens)[1] == "("
            entity = Entity(token, self._list(tokens))
            assert next(tokens)[1] == ";"
            return entity
        parts = []
        assert token == "("
        for _, word in tokens:
            if word == ")":
                break
            assert next(tokens)[1] == "("
            parts.append(Entity(word, self._list(tokens)))
        assert next(tokens)[1] == ";"
        return Entity("", parts)

    def _list(self, tokens: Iterator[tuple[str, str]]) -> list[Any]:
        values: list[Any] = []
        for kind, token in tokens:
            if token == ")":
                return values
            if token == "(":
                values.append(self._list(tokens))
            elif kind == "ref":
                self.used[int(token[1:])] += 1
                values.append(Ref(int(token[1:])))
            elif kind == "number":
                values.append(float(token) if "." in token else int(token))
            elif kind == "word":  # a value with its type, such as LENGTH_MEASURE(1.)
                assert next(tokens)[1] == "("
                values.append(Entity(token, self._list(tokens)))
            elif token != ",":
                values.append(token)
        raise AssertionError("a list without an end")

    def __getitem__(self, ref: Ref) -> Entity:
        return self.entities[ref.number]

    def of_kind(self, kind: str) -> list[tuple[Ref, Entity]]:
        return [(Ref(number), entity) for number, entity in self.entities.items() if entity.kind == kind]

    def vector(self, ref: Ref) -> Floats:
        """A CARTESIAN_POINT or DIRECTION."""
        entity = self[ref]
        assert entity.kind in ("CARTESIAN_POINT", "DIRECTION")
        assert len(entity.values[1]) == 3
        assert all(isinstance(value, float) for value in entity.values[1])
        return np.array(entity.values[1])

    def axes(self, ref: Ref) -> tuple[Floats, Floats]:
        """Origin, and the directions x, y, z as rows, of an AXIS2_PLACEMENT_3D."""
        entity = self[ref]
        assert entity.kind == "AXIS2_PLACEMENT_3D"
        origin, z, x = (self.vector(value) for value in entity.values[1:])
        assert abs(np.linalg.norm(z) - 1) < 3e-9
        assert abs(np.linalg.norm(x) - 1) < 3e-9
        assert abs(x @ z) < 3e-9
        return origin, np.stack([x, np.cross(z, x), z])


def _tokens(text: str) -> Iterator[tuple[str, str]]:
    names = ("ref", "string", "enum", "number", "word", "sign")
    at, end = 0, len(text.rstrip())
    while at < end:
        found = _TOKEN.match(text, at)
        assert found is not None, f"{text[at : at + 40]!r} is no token"
        at = found.end()
        assert found.lastindex is not None
        yield names[found.lastindex - 1], found[found.lastindex]


@dataclass(frozen=True, slots=True)
class Edge:
    """An edge's ends (as vertex numbers) and points along its curve, first and last at the ends."""

    start: int
    end: int
    points: Floats
    tolerance_mm: float


class SolidChecker:
    """Everything that makes one MANIFOLD_SOLID_BREP of a file a closed, consistently turned and exact solid."""

    def __init__(self, file: StepFile, solid: Ref) -> None:
        self.file = file
        shell = file[file[solid].values[1]]
        assert shell.kind == "CLOSED_SHELL"
        self.faces: list[Ref] = list(shell.values[1])
        assert len(set(self.faces)) == len(self.faces), "a face is listed twice"
        self.edges: dict[Ref, Edge] = {}
        self.uses: Counter[tuple[Ref, bool]] = Counter()
        self.off_mm = 0.0

    def check(self) -> None:
        """Raise AssertionError where something is wrong."""
        for face in self.faces:
            self._face(face)
        for edge in self.edges:
            there, back = self.uses[edge, True], self.uses[edge, False]
            assert (there, back) == (1, 1), f"#{edge.number} is used {there} times forward, {back} times backward"
        places = np.array([point for edge in self.edges.values() for point in edge.points[[0, -1]]])
        numbers = np.array([end for edge in self.edges.values() for end in (edge.start, edge.end)])
        first = places[np.unique(numbers, return_index=True)[1]]
        order = np.lexsort(first.T)
        gaps = np.abs(np.diff(first[order], axis=0)).max(axis=1)
        assert (gaps > 1e-6).all(), "two vertices stand in one place"
        self._euler(len(first))

    def _euler(self, vertices: int) -> None:
        """Vertices - edges + faces - (loops - faces) = 2 (1 - genus), an even number."""
        loops = sum(len(self.file[face].values[1]) for face in self.faces)
        characteristic = vertices - len(self.edges) + 2 * len(self.faces) - loops
        assert characteristic % 2 == 0, f"Euler characteristic {characteristic}"
        assert characteristic <= 2, f"Euler characteristic {characteristic}: more than one body"
        self.genus = 1 - characteristic // 2

    def _edge(self, ref: Ref) -> Edge:
        if ref in self.edges:
            return self.edges[ref]
        entity = self.file[ref]
        assert entity.kind == "EDGE_CURVE"
        _, start, end, curve, sense = entity.values
        assert sense == ".T."
        a, b = (self.file.vector(self.file[vertex].values[1]) for vertex in (start, end))
        tolerance = _tolerance_mm(self.file[curve])
        points = self._curve(self.file[curve], a, b, start == end)
        for place, name in ((a, 0), (b, -1)):
            off = float(np.linalg.norm(points[name] - place))
            assert off < tolerance, f"an end of #{ref.number} is {off:.1e} mm off its curve"
            points[name] = place
        self.edges[ref] = Edge(start.number, end.number, points, tolerance)
        return self.edges[ref]

    def _curve(self, curve: Entity, a: Floats, b: Floats, closed: bool) -> Floats:
        """Points of a curve from a to b, in its own direction."""
        file, share = self.file, np.linspace(0.0, 1.0, _SAMPLES + 1)
        if curve.kind == "LINE":
            at, vector = file.vector(curve.values[1]), file[curve.values[2]]
            along = file.vector(vector.values[1])
            assert vector.values[2] == 1.0
            assert abs(np.linalg.norm(along) - 1) < 3e-9
            s, t = (a - at) @ along, (b - at) @ along
            assert t > s + 1e-6, "a line runs backward or has no length"
            points: Floats = at + (s + share * (t - s))[:, None] * along
            return points
        if curve.kind in ("CIRCLE", "ELLIPSE"):
            origin, axes = file.axes(curve.values[1])
            radii = np.array([curve.values[2], curve.values[-1]])
            assert (radii > 0).all()
            assert curve.kind == "CIRCLE" or radii[0] >= radii[1], "an ellipse's first half axis is the longer one"
            s, t = (np.arctan2((p - origin) @ axes[1] / radii[1], (p - origin) @ axes[0] / radii[0]) for p in (a, b))
            turn = 2 * pi if closed else (t - s) % (2 * pi)
            assert turn > 1e-7
            angle = s + share * turn
            on: Floats = origin + np.stack([np.cos(angle), np.sin(angle)], axis=1) * radii @ axes[:2]
            return on
        assert curve.kind == "B_SPLINE_CURVE_WITH_KNOTS"
        degree, controls, multiplicities, knots = (curve.values[i] for i in (1, 2, 6, 7))
        poles = np.array([file.vector(pole) for pole in controls])
        full = np.repeat(knots, multiplicities)
        assert len(full) == len(poles) + degree + 1
        places = knots[0] + np.linspace(0.0, 1.0, 4 * _SAMPLES + 1) * (knots[-1] - knots[0])
        return np.array([_de_boor(float(u), degree, full, poles) for u in places])

    def _face(self, ref: Ref) -> None:
        face = self.file[ref]
        assert face.kind == "ADVANCED_FACE"
        _, bounds, surface, sense = face.values
        assert bounds
        assert len(set(bounds)) == len(bounds)
        loops = [self._loop(bound) for bound in bounds]
        out = 1.0 if sense == ".T." else -1.0
        for loop in loops:
            for points, tolerance in loop:
                off = float(np.abs(self._off(self.file[surface], points)).max())
                self.off_mm = max(self.off_mm, off)
                assert off < tolerance, f"an edge of face #{ref.number} is {off:.1e} mm off its {self.file[surface].kind}"
        areas = [out * self._area(self.file[surface], loop) for loop in loops]
        named = [i for i, bound in enumerate(bounds) if self.file[bound].kind == "FACE_OUTER_BOUND"]
        if self.file[surface].kind == "PLANE" or self.file[surface].kind == "CYLINDRICAL_SURFACE":
            outer = [i for i, area in enumerate(areas) if area > 0]
            assert len(outer) == 1, f"face #{ref.number} has {len(outer)} outer loops"
            assert named in ([], outer), f"face #{ref.number}: another loop is marked as the outer one"
            assert areas[outer[0]] > -sum(area for area in areas if area < 0)
        else:
            assert len(loops) == 1
            assert areas[0] > 0, f"face #{ref.number} is turned over"

    def _loop(self, bound: Ref) -> list[tuple[Floats, float]]:
        """Points along every edge of a bound, as it is followed."""
        entity = self.file[bound]
        assert entity.kind in ("FACE_BOUND", "FACE_OUTER_BOUND")
        assert entity.values[2] == ".T."
        loop = self.file[entity.values[1]]
        assert loop.kind == "EDGE_LOOP"
        followed, ends = [], []
        for oriented in loop.values[1]:
            step = self.file[oriented]
            assert (step.kind, step.values[1:3]) == ("ORIENTED_EDGE", ["*", "*"])
            edge, forward = self._edge(step.values[3]), step.values[4] == ".T."
            self.uses[step.values[3], forward] += 1
            followed.append((edge.points if forward else edge.points[::-1], edge.tolerance_mm))
            ends.append((edge.start, edge.end) if forward else (edge.end, edge.start))
        assert all(a[1] == b[0] for a, b in zip(ends, [*ends[1:], ends[0]], strict=True)), "a loop does not close"
        return followed

    def _local(self, surface: Entity, points: Floats) -> Floats:
        origin, axes = self.file.axes(surface.values[1])
        local: Floats = (points - origin) @ axes.T
        return local

    def _off(self, surface: Entity, points: Floats) -> Floats:
        """Distance of points from a surface."""
        x, y, z = self._local(surface, points).T
        across = np.hypot(x, y)
        if surface.kind == "PLANE":
            return np.asarray(z)
        if surface.kind == "CYLINDRICAL_SURFACE":
            return np.asarray(across - surface.values[2])
        if surface.kind == "SPHERICAL_SURFACE":
            return np.asarray(np.hypot(across, z) - surface.values[2])
        assert surface.kind == "CONICAL_SURFACE"
        angle = surface.values[3]
        return np.asarray((across - surface.values[2]) * np.cos(angle) - z * np.sin(angle))

    def _area(self, surface: Entity, loop: list[tuple[Floats, float]]) -> float:
        """Area that a loop goes round counter-clockwise about the surface's normal; a sign at least."""
        points = np.concatenate([points[:-1] for points, _ in loop])
        local = self._local(surface, points)
        if surface.kind == "PLANE":
            u, v = local[:, 0], local[:, 1]
        elif surface.kind == "CYLINDRICAL_SURFACE":
            u, v = np.unwrap(np.arctan2(local[:, 1], local[:, 0])), local[:, 2]
            assert abs(u[-1] - u[0]) < 2 * pi, "a cylinder's face goes all the way round"
        else:
            return self._bulge(surface, loop)
        return float(u @ np.roll(v, -1) - v @ np.roll(u, -1)) / 2

    def _bulge(self, surface: Entity, loop: list[tuple[Floats, float]]) -> float:
        """Of a cap or a cone's side: the sense in which its widest closed edge goes round the surface's outside."""
        closed = [points for points, _ in loop if np.linalg.norm(points[0] - points[-1]) < 1e-6]
        foot = max(closed, key=lambda points: float(np.ptp(points, axis=0).max()))
        middle = foot[:-1].mean(axis=0)
        origin, axes = self.file.axes(surface.values[1])
        # of a cone the foot is the wider end: the side's outside is seen from the narrow one
        outward = middle - origin if surface.kind == "SPHERICAL_SURFACE" else -axes[2]
        turn = np.cross(foot[:-1] - middle, foot[1:] - middle).sum(axis=0)
        return float(turn @ outward)


def _tolerance_mm(curve: Entity) -> float:
    """A direction that is rounded turns a circle or an ellipse about its centre."""
    if curve.kind in ("CIRCLE", "ELLIPSE"):
        return TOLERANCE_MM + 1e-9 * float(curve.values[2])
    return SPLINE_TOLERANCE_MM if curve.kind.startswith("B_SPLINE") else TOLERANCE_MM


def _de_boor(u: float, degree: int, knots: Floats, poles: Floats) -> Floats:
    span = min(int(np.searchsorted(knots, u, side="right")) - 1, len(poles) - 1)
    d = [poles[j + span - degree] for j in range(degree + 1)]
    for r in range(1, degree + 1):
        for j in range(degree, r - 1, -1):
            low, high = knots[j + span - degree], knots[j + 1 + span - r]
            share = (u - low) / (high - low)
            d[j] = (1 - share) * d[j - 1] + share * d[j]
    return np.asarray(d[degree])


def check_solids(data: bytes) -> list[SolidChecker]:
    """Check every solid of a file; the checkers, with what they found."""
    file = StepFile(data)
    checkers = [SolidChecker(file, ref) for ref, _ in file.of_kind("MANIFOLD_SOLID_BREP")]
    for checker in checkers:
        checker.check()
    return checkers
