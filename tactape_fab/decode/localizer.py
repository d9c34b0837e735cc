"""Localizer: a registry of tapes and a sensor, prepared once; then one frame after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import exp, log, pi
from time import perf_counter
from typing import Literal

import numpy as np
import numpy.typing as npt

from tactape_fab.decode.detect import Dots, detect, trusted
from tactape_fab.decode.door import LARGE, canonical_frame, dot_numbers
from tactape_fab.decode.lattice import find_lattices
from tactape_fab.decode.match import tape_planes
from tactape_fab.decode.plane import CodePlane, PlanePlace
from tactape_fab.decode.pose import Pose, fit_pose
from tactape_fab.decode.registry import distinct, families
from tactape_fab.decode.result import SOLID_DOTS, Localization, status_of
from tactape_fab.decode.rivals import strongest_rival
from tactape_fab.decode.search import Place, Prior, search
from tactape_fab.decode.symbols import fit_grid, posteriors
from tactape_fab.errors import FrameError, Problem, SpecError
from tactape_fab.profiles.sensors import SensorProfile, load_sensor
from tactape_fab.texture.code import BoolArray, encode, get_code
from tactape_fab.texture.frames import DIRECTIONS_XY, FloatArray, IntArray, texture_to_board
from tactape_fab.texture.tape import Tape

World = Literal["open", "closed"]
Method = Literal["ml", "paper"]

LEAST_DOTS = 6
LATTICES = 3
LEAST_LATTICE_SHARE = 0.12
PAD = 24
"""Cells that a contact may hang over a tape's edge; also the largest contact in cells."""
UNREGISTERED_SHARE = 0.01
KAPPA = 30.0
OVERHANG = 3
"""Cells by which a rival may hang over its edge where the answer does not."""


class Localizer:
    """Locates contacts on registered tapes, or in a code's plane (`from_code`).

    Parameters
    ----------
    tapes : sequence of Tape
        Tapes of equal code, sector, origin, W and Delta are one tape (the first one's name).
    sensor : str or SensorProfile
        Profile name, path of a TOML file, or a profile.
    method : {"ml", "paper"}
        All dots together, or section III of the paper as it is written, for comparison: no bounds then.
    max_p_false : float
        Largest accepted bound on being wrong.
    max_p_tape : float or None
        Largest accepted bound on the texture being none of ours; part of `max_p_false` where None.
    world : {"open", "closed"}
        Whether tapes of the family that nobody registered may be touched.
    unregistered_share : float
        Prior weight of all unregistered tapes together, in an open world.
    kappa : float
        Least lead, as a factor, over any single other place.
    fixed_scale : bool
        Take the profile's px/mm as it is; otherwise a frame that says otherwise is believed.

    Raises
    ------
    SpecError
        When there is no tape, tapes differ in W or Delta, or a value is out of range.
    """

    def __init__(
        self,
        tapes: Sequence[Tape],
        sensor: str | SensorProfile = "gelsight-mini",
        *,
        method: Method = "ml",
        max_p_false: float = 1e-4,
        max_p_tape: float | None = None,
        world: World = "open",
        unregistered_share: float = UNREGISTERED_SHARE,
        kappa: float = KAPPA,
        fixed_scale: bool = False,
    ) -> None:
        problems = []
        if method not in ("ml", "paper"):
            problems.append(Problem("method", f"method = {method!r} is neither 'ml' nor 'paper'; give one of them"))
        if not tapes:
            problems.append(Problem("tape", "no tape is registered; give the kits that can be touched"))
        if world not in ("open", "closed"):
            problems.append(Problem("world", f"world = {world!r} is neither 'open' nor 'closed'; give one of them"))
        for key, value in (("max_p_false", max_p_false), ("max_p_tape", max_p_tape), ("unregistered_share", unregistered_share)):
            if value is not None and not 0.0 < value < 1.0:
                problems.append(Problem(key, f"{key} = {value!r} is not between 0 and 1; give a probability such as 1e-4"))
        if not kappa >= 1.0:
            problems.append(Problem("kappa", f"kappa = {kappa!r} is below 1; give the least lead over any rival, such as 30"))
        sizes = sorted({(tape.pitch_mm, tape.displacement_mm) for tape in tapes})
        if len(sizes) > 1:
            said = ", ".join(f"W {w:g} and Δ {d:g} mm" for w, d in sizes)
            problems.append(
                Problem(
                    "tape",
                    f"the tapes differ in pitch or displacement ({said}); use one Localizer for each, or decode once for each",
                )
            )
        if problems:
            raise SpecError(problems)
        self.sensor = load_sensor(sensor) if isinstance(sensor, str) else sensor
        self.tapes = distinct(tapes)
        self.pitch_mm, self.displacement_mm = sizes[0]
        self._max_p_false, self._max_p_tape, self._world = max_p_false, max_p_tape, world
        self._share = unregistered_share if world == "open" else 0.0
        self._kappa, self._fixed_scale = kappa, fixed_scale
        self._method = method
        self._plane: CodePlane | None = None
        self._planes = [tape_planes(tape, PAD) for tape in self.tapes]
        self._families = families(self.tapes, PAD) if world == "open" else {}
        tape = self.tapes[0]
        cells = tape.cells()[tape.cells()[:, 0] < 8][:64]
        symbols = tape.symbols[cells[:, 1], cells[:, 0]]
        self._warm(cells * tape.pitch_mm + tape.displacement_mm * DIRECTIONS_XY[symbols])

    @classmethod
    def from_code(
        cls,
        code: str,
        pitch_mm: float,
        displacement_mm: float,
        sensor: str | SensorProfile = "gelsight-mini",
        *,
        max_p_false: float = 1e-4,
        kappa: float = KAPPA,
        fixed_scale: bool = False,
    ) -> Localizer:
        """A localizer that knows no tape, only a code and its W and Delta: every place of the plane in every sector.

        It asks for many more dots. Its answers have sector, index, theta and ``plane_mm``; no tape, no position on one.

        Raises
        ------
        SpecError
            When the code is unknown, or its plane too large to search.
        """
        self = cls.__new__(cls)
        problems = [
            Problem(key, f"{key} = {value!r} mm is not above 0 and at most {most:g} mm; give it in millimetres")
            for key, value, most in (("w", pitch_mm, 100.0), ("delta", displacement_mm, pitch_mm / 2))
            if not 0.0 < value <= most
        ]
        if problems:
            raise SpecError(problems)
        self._plane = CodePlane(get_code(code), PAD)
        self.sensor = load_sensor(sensor) if isinstance(sensor, str) else sensor
        self.tapes, self._planes, self._families, self._share = [], [], {}, 0.0
        self.pitch_mm, self.displacement_mm, self._method = pitch_mm, displacement_mm, "ml"
        self._max_p_false, self._max_p_tape = max_p_false, None
        self._kappa, self._fixed_scale = kappa, fixed_scale
        symbols = encode(self._plane.code, 0, (0, 0), (8, 8))
        row, column = np.divmod(np.arange(64), 8)
        self._warm(np.stack([column, row], axis=1) * pitch_mm + displacement_mm * DIRECTIONS_XY[symbols[row, column]])
        return self

    def _warm(self, texture_mm: FloatArray) -> None:
        """Compile everything now, so that no frame waits."""
        scale = self._px_per_mm
        xy = (texture_mm - texture_mm.mean(axis=0)) * scale + self._centre_px
        self.locate_dots(xy / (1.0, self._aspect), np.ones(len(xy)))
        v, u = np.mgrid[: self.sensor.height_px, : self.sensor.width_px]
        ripple = np.cos(2 * pi * u / (scale * self.pitch_mm)) * np.cos(2 * pi * v / (scale * self.pitch_mm))
        detect(ripple.astype(np.float32), scale)

    @property
    def _px_per_mm(self) -> float:
        """Scale of square pixels: that along u."""
        return self.sensor.px_per_mm[0]

    @property
    def _aspect(self) -> float:
        """What v is stretched by to make pixels square."""
        return self.sensor.px_per_mm[0] / self.sensor.px_per_mm[1]

    @property
    def _centre_px(self) -> FloatArray:
        """The image centre p0 in square pixels."""
        centre: FloatArray = self.sensor.centre_px * np.array([1.0, self._aspect])
        return centre

    def locate(self, depth: npt.ArrayLike, *, prior: Prior | None = None, timestamp: float | None = None) -> Localization:
        """Locate a contact from a depth map.

        Parameters
        ----------
        depth : array_like, shape (h, w)
            As the sensor delivers it; any positive scale, any smooth background.
        prior : Prior, optional
            Where the contact is believed to be; the bound stays true when that is wrong.
        timestamp : float, optional
            Passed through.

        Raises
        ------
        FrameError
            When it is no depth map of this sensor.
        """
        start = perf_counter()
        image = canonical_frame(depth, self.sensor)
        if self._method == "paper":
            return self._by_paper(image, start, timestamp)
        dots = detect(image, float(np.sqrt(self.sensor.px_per_mm[0] * self.sensor.px_per_mm[1])))
        if self.sensor.mask is not None and len(dots.weights):
            u, v = np.rint(dots.xy_px).astype(np.int64).T
            h, w = self.sensor.mask.shape
            valid = self.sensor.mask[np.clip(v, 0, h - 1), np.clip(u, 0, w - 1)]
            dots = Dots(xy_px=dots.xy_px[valid], weights=dots.weights[valid], trust=dots.trust[valid])
        dots = replace(dots, xy_px=dots.xy_px * (1.0, self._aspect))
        found = self._locate(dots, prior)
        return replace(found, elapsed_ms=(perf_counter() - start) * 1000.0, timestamp=timestamp)

    def _by_paper(self, image: npt.NDArray[np.float32], start: float, timestamp: float | None) -> Localization:
        import cv2

        from tactape_fab.decode.paper import locate_paper

        if self._aspect != 1.0:
            image = np.asarray(cv2.resize(image, None, fx=1.0, fy=self._aspect, interpolation=cv2.INTER_LINEAR), dtype=np.float32)
        found, _ = locate_paper(image, self.tapes, px_per_mm=self.sensor.px_per_mm[0])
        return replace(found, elapsed_ms=(perf_counter() - start) * 1000.0, timestamp=timestamp)

    def locate_dots(
        self,
        xy_px: npt.ArrayLike,
        weights: npt.ArrayLike | None = None,
        *,
        prior: Prior | None = None,
        timestamp: float | None = None,
    ) -> Localization:
        """Locate a contact from dots that somebody else detected.

        Parameters
        ----------
        xy_px : array_like, shape (n, 2)
            Canonical image frame.
        weights : array_like, shape (n,), optional
            Heights; 1 is an ordinary good dot.
        """
        start = perf_counter()
        xy = dot_numbers(xy_px)
        if xy.size == 0:
            xy = xy.reshape(0, 2)
        w = np.ones(len(xy)) if weights is None else dot_numbers(weights)
        if xy.ndim != 2 or xy.shape[1] != 2 or w.shape != (len(xy),):
            raise FrameError(f"dots of shape {xy.shape} with weights of shape {w.shape} are none; give (n, 2) and (n,)")
        if not (np.isfinite(xy).all() and np.isfinite(w).all() and (w >= 0).all()):
            raise FrameError("dots hold values that are no numbers, or negative weights; leave those dots out")
        if self._method == "paper":
            from tactape_fab.decode.paper import locate_paper_dots

            size = (self.sensor.width_px, self.sensor.height_px)
            found, _ = locate_paper_dots(xy, self.tapes, size, px_per_mm=self.sensor.px_per_mm[0])
        else:
            square = xy * (1.0, self._aspect)
            found = self._locate(Dots(xy_px=square, weights=w, trust=trusted(w)), prior)
        return replace(found, elapsed_ms=(perf_counter() - start) * 1000.0, timestamp=timestamp)

    # From dots to the answer

    def _locate(self, dots: Dots, prior: Prior | None) -> Localization:
        found = self._read(dots, prior)
        if found.located or len(dots.weights) < SOLID_DOTS:
            return found
        flipped = dots.xy_px * (-1.0, 1.0) + (2.0 * self._centre_px[0], 0.0)
        mirrored = self._read(replace(dots, xy_px=flipped), None)  # a mirrored frame is no answer, but worth a word
        if mirrored.located:
            said = f"the frame is mirrored: it shows {mirrored.tape or mirrored.sector} from behind"
            return replace(found, reason=f"{said}; set mirror in the sensor profile")
        return found

    def _read(self, dots: Dots, prior: Prior | None) -> Localization:
        n = len(dots.weights)
        empty = Localization(status=status_of(n), located=False, n_dots=n)
        if n < LEAST_DOTS:
            return replace(empty, reason="no dots" if n == 0 else f"only {n} dots")
        if dots.trust.sum() < 1.0 or np.abs(dots.xy_px).max() > LARGE:
            return replace(empty, reason="no dot stands out of the noise")
        middle = dots.trust @ dots.xy_px / dots.trust.sum()
        xy = dots.xy_px - middle
        pitch_px, shift = self.pitch_mm * self._px_per_mm, self.displacement_mm / self.pitch_mm
        tolerance = 0.0 if self._fixed_scale else self.sensor.scale_tolerance
        best: tuple[Place | PlanePlace, FloatArray] | None = None
        tried = 0
        lattice_weights = dots.trust * np.minimum(dots.weights, 1.0)
        for most in (1, LATTICES):  # the best grid is nearly always the one; the others are for when it is not
            lattices = find_lattices(xy, lattice_weights, pitch_px, tolerance, most)
            for angle, pitch, phase_a, phase_b, share in lattices[tried:].tolist():
                tried += 1
                if share < LEAST_LATTICE_SHARE:
                    continue
                grid, nodes, squares, sigma = fit_grid(
                    xy, dots.weights, dots.trust, angle, pitch, phase_a, phase_b, shift, not self._fixed_scale
                )
                if not np.isfinite(grid).all():
                    continue
                q = posteriors(squares, dots.weights, dots.trust, sigma)
                if self._plane is not None:
                    place: Place | PlanePlace | None = self._plane.search(nodes, q)
                else:
                    place = search(self.tapes, self._planes, nodes, q, grid, self._centre_px - middle, prior)
                if place is not None and np.isfinite(place.score) and (best is None or place.score > best[0].score):
                    best = place, grid
            if best is not None and log(LATTICES) - best[0].weight - best[0].score < log(self._max_p_false) - 2.0:
                break
        if best is None:
            return replace(empty, reason="the dots stand on no grid of this pitch")
        return self._answer(empty, dots, best[0], tried)

    def _answer(self, empty: Localization, dots: Dots, place: Place | PlanePlace, tried: int) -> Localization:
        p_tape = exp(min(log(max(tried, 1)) - place.weight - place.score, 0.0))
        cells = place.cells
        if isinstance(place, Place):
            tape = self.tapes[place.tape]
            inside = np.asarray(((cells >= 0) & (cells < (tape.columns, tape.rows))).all(axis=1))
            inside[inside] &= tape.placed[cells[inside, 1], cells[inside, 0]]
            symbols = tape.symbols[cells[inside, 1], cells[inside, 0]]
        else:
            inside = np.ones(len(cells), dtype=bool)
            symbols = (place.x_bits + 2 * place.y_bits).astype(np.uint8)
        p_place, lead, unregistered = self._rivals(place, inside)
        judged = replace(empty, p_tape=p_tape, p_place=p_place, p_false=min(1.0, p_tape + p_place))
        if inside.sum() < LEAST_DOTS:
            seen = f"looks like {unregistered}, which is not registered"
            return replace(judged, reason=seen if unregistered is not None else "too few dots lie on a tape")
        on = cells[inside]
        nominal = on * self.pitch_mm + self.displacement_mm * DIRECTIONS_XY[symbols]
        offset = dots.xy_px[inside] - self._centre_px
        weights = dots.weights[inside] * dots.trust[inside]
        pose = fit_pose(offset, nominal, weights, self._px_per_mm, fixed_scale=self._fixed_scale)
        if not (np.isfinite(pose.position_mm).all() and np.isfinite(pose.covariance).all() and np.isfinite(pose.px_per_mm)):
            return replace(judged, reason="the dots give no pose")
        reason = self._refusal(judged, lead, unregistered, pose, dots.trust[inside])
        judged = replace(judged, n_agree=int(pose.agree.sum()))
        if reason is not None:
            return replace(judged, reason=reason)
        return self._described(judged, place, on[pose.agree], nominal[pose.agree], offset[pose.agree], dots, pose)

    def _rivals(self, place: Place | PlanePlace, used: BoolArray) -> tuple[float, float, str | None]:
        """p_place, the least lead over any rival (ln), and the unregistered tape that fits at least as well."""
        registered = (1.0 - self._share) * exp(place.weight)
        weight = registered * place.other_sum
        lead = place.score - place.other_best
        better = None
        if isinstance(place, Place) and self._families:
            everywhere = sum(family.places for family in self._families.values())
            clear = log(everywhere) - log(self._max_p_false)  # as sure as an answer would have to be
            tape = self.tapes[place.tape]
            for dots in _seen_by_rivals(place.cells, used, tape.columns, tape.rows):
                total, largest, name = strongest_rival(self._families, place.turns, dots, place.score)
                weight += self._share / everywhere * total
                if largest > max(clear, place.score - log(self._kappa)) and place.score - largest < lead:
                    better = name
                lead = min(lead, place.score - largest)
        return weight / (registered + weight), lead, better

    def _refusal(self, judged: Localization, lead: float, unregistered: str | None, pose: Pose, trust: FloatArray) -> str | None:
        """Why an answer cannot be trusted; None where it can."""
        p_tape, p_place, p_false = judged.p_tape or 0.0, judged.p_place or 0.0, judged.p_false or 0.0
        if unregistered is not None:
            return f"looks like {unregistered}, which is not registered"
        if self._max_p_tape is None:
            trusted_enough = p_false <= self._max_p_false
        else:
            trusted_enough = p_tape <= self._max_p_tape and p_place <= self._max_p_false
        if not trusted_enough:
            what = "may be no tape of ours" if p_tape > p_place else "several places fit"
            return f"{what}: p_false {p_false:.1e} exceeds {self._max_p_false:.1e}"
        if lead < log(self._kappa):
            return f"another place fits nearly as well: it leads by a factor of {exp(lead):.1f}, less than {self._kappa:g}"
        good = int((trust > 0.5).sum())
        if pose.agree.sum() < max(LEAST_DOTS, good // 2):
            return f"only {int(pose.agree.sum())} of {good} dots agree with the place that their symbols name"
        return None

    def _described(
        self,
        judged: Localization,
        place: Place | PlanePlace,
        cells: IntArray,
        nominal: FloatArray,
        offset: FloatArray,
        dots: Dots,
        pose: Pose,
    ) -> Localization:
        centre = dots.trust @ dots.xy_px / dots.trust.sum() - self._centre_px
        nearest = int(np.hypot(*(offset - centre).T).argmin())
        column, row = (int(v) for v in cells[nearest])
        x, y = (float(v) for v in pose.position_mm)
        theta_deg = float(np.degrees(pose.theta_rad))
        found = replace(
            judged,
            located=True,
            theta_deg=180.0 if theta_deg <= -180.0 else theta_deg,
            px_per_mm=float(pose.px_per_mm),
            covariance=pose.covariance,
        )
        if isinstance(place, PlanePlace):
            return replace(found, sector=place.sector, index=(column, row), plane_mm=(x, y))
        tape = self.tapes[place.tape]
        board = None if tape.surface is not None else texture_to_board(pose.position_mm, tape.board.texture_origin_mm)
        return replace(
            found,
            tape=tape.name,
            sector=tape.sector,
            position_mm=(x, y),
            board_mm=None if board is None else (float(board[0]), float(board[1])),
            contact_mm=(float(nominal[nearest, 0]), float(nominal[nearest, 1])),
            cell=(column, row),
            index=(tape.origin[0] + column, tape.origin[1] + row),
        )


def _seen_by_rivals(cells: IntArray, used: BoolArray, columns: int, rows: int) -> list[BoolArray]:
    """Which dots an unregistered tape may be held against.

    All of them; and near an edge of the answer's tape, where a rival at the same origin has its edge as well, also without
    the outermost lines: a contact over a foreign tape's edge with dirt beside it would else not be recognised as that tape's.

    Parameters
    ----------
    cells : ndarray of int, shape (n, 2)
        Column and row of each dot on the answer's tape.
    used : ndarray of bool, shape (n,)
        Dots that lie on it.
    """
    everything = np.ones(len(cells), dtype=bool)
    if not used.any():
        return [everything]
    chosen = [everything] if used.all() else [everything, used]
    kept: list[list[BoolArray]] = []
    for axis, count in ((0, columns), (1, rows)):
        along = cells[:, axis]
        ways = [everything]
        if along[used].min() < OVERHANG:
            ways += [along >= along[used].min() + m for m in range(OVERHANG + 1)]
        if along[used].max() >= count - OVERHANG:
            ways += [along <= along[used].max() - m for m in range(OVERHANG + 1)]
        kept.append(ways)
    chosen += [dots & x & y for dots in chosen[-1:] for x in kept[0] for y in kept[1] if not (x.all() and y.all())]
    return [dots for dots in chosen if dots.sum() >= LEAST_DOTS]
