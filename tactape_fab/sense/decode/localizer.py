"""Localizer: a registry of tapes and a sensor, prepared once; then one frame after the other."""

from __future__ import annotations

import gc
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from math import pi
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import FrameError, Problem, SpecError, refuse, tried
from tactape_fab.base.fields import Fields, shown
from tactape_fab.base.given_value import as_real
from tactape_fab.base.jit import COMPILED
from tactape_fab.base.templates import DEFAULT_SENSOR
from tactape_fab.sense.decode.accept import accept_place
from tactape_fab.sense.decode.contact.surface import contact_view
from tactape_fab.sense.decode.cut_tops import as_cut, cut_share
from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.dots.filters import Image
from tactape_fab.sense.decode.dots.inputs import LARGE, canonical_depths, dot_numbers
from tactape_fab.sense.decode.dots.rim import settled
from tactape_fab.sense.decode.grid.beliefs import beliefs_of
from tactape_fab.sense.decode.pixels.patches import pixel_fit
from tactape_fab.sense.decode.pixels.refine import Pixels, rehearse_pixels
from tactape_fab.sense.decode.rank import View, read
from tactape_fab.sense.decode.result import SOLID_DOTS, Localization, Refined, status_of
from tactape_fab.sense.decode.rule import KAPPA, LEAST_DOTS, MAX_P_FALSE, UNREGISTERED_SHARE, Limits, trusted
from tactape_fab.sense.decode.search.hypotheses import Registry, register
from tactape_fab.sense.decode.search.matrices import LARGEST_CONTACT
from tactape_fab.sense.decode.search.plane import CodePlane
from tactape_fab.sense.decode.search.prior import Prior
from tactape_fab.sense.decode.search.sequence_plane import SequencePlane
from tactape_fab.sense.decode.search.trace_plane import TracePlane
from tactape_fab.sense.decode.settings import Method, World, given_settings, setting_problems, tape_problems
from tactape_fab.sense.decode.square_image import square_image
from tactape_fab.sense.decode.warm import announce, rehearse
from tactape_fab.sense.decode.wrong_profile import Seen, wrong_profile
from tactape_fab.sense.sensors import SensorProfile, as_sensor
from tactape_fab.texture.code import get_plane
from tactape_fab.texture.frames import DIRECTIONS_XY
from tactape_fab.texture.part import TapePart
from tactape_fab.texture.plane import Plane, PlaneCode, encode
from tactape_fab.texture.registry import TapeLike, as_tapes
from tactape_fab.texture.tape import Tape, read_displacement, read_pitch
from tactape_fab.texture.trace import TraceCode

_MOST_NAMED = 8
"""Largest number of tapes that a message names: a registry may have thousands."""


def _stamped(found: Localization, start: float, timestamp: float | None) -> Localization:
    """Set the times of a new answer, in place as nobody else has it yet; `dataclasses.replace` would take 10 us."""
    if timestamp is not None:
        timestamp = as_real(timestamp, "timestamp", "number", "the capture time in seconds, or leave it out")
    object.__setattr__(found, "elapsed_ms", (perf_counter() - start) * 1000.0)
    object.__setattr__(found, "timestamp", timestamp)
    return found


class Localizer:
    """Locates contacts on registered tapes, or in a code's plane (`from_code`).

    Parameters
    ----------
    tapes : Tape, path, or sequence of either
        The tapes that can be touched, or paths of kits, panels, manifests or folders of kits. Tapes of equal code,
        sector, origin, W and Delta are one tape (with the first one's name).
    sensor : str, Path or SensorProfile
        Profile name, path of a TOML file, or a profile.
    method : {"ml", "paper"}
        All dots together, or section III of the paper as written, for comparison and without bounds.
    max_p_false : float
        Largest accepted bound on the probability of a wrong answer.
    max_p_tape : float or None
        Largest accepted bound on the probability that the texture is unregistered; None for a part of `max_p_false`.
    world : {"open", "closed"}
        Whether unregistered tapes of the same code may be touched.
    unregistered_share : float
        Prior weight of all unregistered tapes together, in an open world.
    kappa : float
        Least lead, as a factor, over any single other place.
    fixed_scale : bool
        Use the profile's px/mm without correction; otherwise a scale measured in the frame replaces it.
    refine : {"dots", "pixels"} or None
        What the pose of a located answer is fitted to: the centres of the dots, or the pixels around them, which is
        more exact where the parts are boxes that stand where they should. `Localization.refined` says what it was. None:
        the pixels where the sensor's profile knows the gel's blur (``gel.blur_mm``, as `calibrate` writes it), else the dots.

    Raises
    ------
    SpecError
        If there is no tape, a path is not a kit, tapes differ in W, Delta or directions, or a value is out of range or has no
        effect beside the others.

    Attributes
    ----------
    sensor : SensorProfile
        The profile in use.

    Examples
    --------
    >>> localizer = Localizer("tactape-s007", sensor="gelsight-mini")  # doctest: +SKIP
    >>> fix = localizer.locate(depth)  # doctest: +SKIP
    """

    def __init__(
        self,
        tapes: TapeLike | Iterable[TapeLike],
        sensor: str | Path | SensorProfile = DEFAULT_SENSOR,
        *,
        method: Method = "ml",
        max_p_false: float = MAX_P_FALSE,
        max_p_tape: float | None = None,
        world: World = "open",
        unregistered_share: float = UNREGISTERED_SHARE,
        kappa: float = KAPPA,
        fixed_scale: bool = False,
        refine: Refined | None = None,
    ) -> None:
        problems: list[Problem] = []
        registered = tried(lambda: as_tapes(tapes), problems)
        tapes = registered or []
        settings: dict[str, Any] = {
            "method": method,
            "max_p_false": max_p_false,
            "max_p_tape": max_p_tape,
            "world": world,
            "unregistered_share": unregistered_share,
            "kappa": kappa,
            "fixed_scale": fixed_scale,
            "refine": refine,
        }
        problems += setting_problems(given_settings(settings))
        if registered == []:
            problems.append(Problem("tape", "no tape is registered; give the kits that can be touched"))
        problems += tape_problems(tapes, method)
        refuse(problems)
        registry = register(tapes, unregistered_share=unregistered_share if world == "open" else 0.0)
        parts = {tape.part.relief for tape in tapes}
        self._method = method
        self._limits = Limits(max_p_false=max_p_false, max_p_tape=max_p_tape, kappa=kappa)
        part = registry.tapes[0].part if len(parts) == 1 else None
        first = registry.tapes[0]
        self._prepare(registry, first.pitch_mm, first.displacement_mm, part, sensor, fixed_scale, first.directions)
        if refine is None and method == "ml" and self.sensor.gel.blur_mm is not None:
            refine = "pixels"
        self._pixel_fit = pixel_fit(self.sensor) if refine == "pixels" else None
        self._warm()

    @classmethod
    def from_code(
        cls,
        code: str,
        pitch_mm: float,
        displacement_mm: float,
        sensor: str | Path | SensorProfile = DEFAULT_SENSOR,
        *,
        max_p_false: float = MAX_P_FALSE,
        kappa: float = KAPPA,
        fixed_scale: bool = False,
    ) -> Localizer:
        """A localizer without tapes, for a code with W and Delta: it searches every place of the plane in every sector.

        It needs many more dots. Its answers have sector, index, theta and ``plane_mm``, but no tape and no position on one.

        Parameters
        ----------
        code : str
            Name of a code that has a plane.
        pitch_mm, displacement_mm : float
            W and Delta of the tapes, mm.
        sensor : str, Path or SensorProfile
        max_p_false, kappa : float
        fixed_scale : bool
            As for `Localizer`.

        Returns
        -------
        Localizer

        Raises
        ------
        SpecError
            If the code is unknown, its plane too large to search, or a value is out of range.
        """
        table = Fields({"w": pitch_mm, "delta": displacement_mm})
        read_displacement(table, "delta", read_pitch(table, "w"), pitch_refused=table.refused("w"))
        settings = {"max_p_false": max_p_false, "kappa": kappa, "fixed_scale": fixed_scale}
        refuse([*table.problems, *setting_problems(given_settings(settings), code=code)])
        self = cls.__new__(cls)
        self._method = "ml"
        self._limits = Limits(max_p_false=max_p_false, max_p_tape=None, kappa=kappa)
        plane = _plane_of(get_plane(code))
        self._prepare(plane, pitch_mm, displacement_mm, None, sensor, fixed_scale)
        self._pixel_fit = None
        self._warm()
        return self

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._warm()  # in the process that a pickled one came to, no frame waits either

    def _prepare(
        self,
        world: Registry | CodePlane,
        pitch_mm: float,
        displacement_mm: float,
        part: TapePart | None,
        sensor: str | Path | SensorProfile,
        fixed_scale: bool,
        directions: int = 4,
    ) -> None:
        self._world = world
        self._names = frozenset(tape.name for tape in self.tapes)
        self.sensor = as_sensor(sensor)
        self._square = square_image(self.sensor)
        self._contact_view = contact_view(self.sensor)
        self._view = View(
            pitch_mm=pitch_mm,
            displacement_mm=displacement_mm,
            part=part,
            px_per_mm=self._square.px_per_mm,
            scale_tolerance=0.0 if fixed_scale else self.sensor.scale_tolerance,
            centre_px=self._square.centre_px,
            beliefs=beliefs_of(self.sensor, fixed_scale=fixed_scale, part=part),
            directions=directions,
        )

    @property
    def tapes(self) -> list[Tape]:
        """The registered tapes, equal ones once; empty if only a code is known."""
        return list(self._world.tapes) if isinstance(self._world, Registry) else []

    def _warm(self) -> None:
        """Compile all kernels now, so that no frame waits."""
        if isinstance(self._world, Registry):
            # a tape itself, with all parts: as it is located, what comes after the search is called as well
            symbols = self._world.tapes[0].symbols[:8, :8]
        else:
            symbols = encode(self._world.code, 0, (0, 0), (8, 8))
        row, column = np.indices(symbols.shape).reshape(2, -1)
        shift_mm = self._view.displacement_mm * DIRECTIONS_XY[symbols[row, column]]
        texture_mm = np.stack([column, row], axis=1) * self._view.pitch_mm + shift_mm
        xy = (texture_mm - texture_mm.mean(axis=0)) * self._view.px_per_mm + self._view.centre_px
        dots = Dots(xy_px=xy, weights=np.ones(len(xy)), trust=np.ones(len(xy)), elongation=np.zeros((len(xy), 2)))
        v, u = np.mgrid[: self.sensor.height_px, : self.sensor.width_px]
        ripple = np.cos(2 * pi * u / self._view.pitch_px) * np.cos(2 * pi * v / self._view.pitch_px)
        collecting = gc.isenabled()
        gc.disable()  # a compiler makes millions of live objects: garbage collection would take a sixth of its time
        try:
            announce()
            registry = self._world if isinstance(self._world, Registry) else None
            rehearse(dots, ripple, self._view, registry, elastic=self._contact_view.elastic)
            if COMPILED:
                self._locate(dots, None)
            if self._pixel_fit is not None:
                rehearse_pixels(self._pixel_fit, [tape.part for tape in self.tapes])
        finally:
            if collecting:
                gc.enable()

    def locate(self, depth: npt.ArrayLike, *, prior: Prior | None = None, timestamp: float | None = None) -> Localization:
        """Locate a contact from a depth map.

        Parameters
        ----------
        depth : array_like, shape (h, w)
            As the sensor delivers it; any positive scale, any smooth background.
        prior : Prior, optional
            Expected region of the contact; the bound stays valid if it is wrong.
        timestamp : float, optional
            Capture time, s; passed through.

        Returns
        -------
        Localization
            A frame that cannot be located gives an answer with `reason`, not an error.

        Raises
        ------
        FrameError
            If it is not a depth map of this sensor.
        SpecError
            When there is a prior that nothing here can use.
        """
        start = perf_counter()
        self._refuse_prior(prior)
        image, as_came = canonical_depths(depth, self.sensor)
        if self._method == "paper":
            found = self._by_paper(image)
            cut = cut_share(image) > 0.0
        else:
            dots = self._square.dots(image)
            cut = dots.small is not None and cut_share(dots.small) > 0.0
            found = self._locate(dots, prior, image, in_mm=as_came and not cut)
        if cut and found.n_dots > 0:
            found = as_cut(found, image)
        return _stamped(found, start, timestamp)

    def locate_dots(
        self,
        xy_px: npt.ArrayLike,
        weights: npt.ArrayLike | None = None,
        *,
        prior: Prior | None = None,
        timestamp: float | None = None,
    ) -> Localization:
        """Locate a contact from dots that were detected elsewhere.

        Parameters
        ----------
        xy_px : array_like, shape (n, 2)
            Centres (u, v) in the canonical image, px: u right, v down, integers at pixel centres.
        weights : array_like, shape (n,), optional
            Heights; 1 is an ordinary good dot.
        prior, timestamp : optional
            As in `locate`.

        Returns
        -------
        Localization

        Raises
        ------
        FrameError
            If shapes do not match, a value is NaN or infinite, or a weight is negative.
        SpecError
            When there is a prior that nothing here can use.
        """
        start = perf_counter()
        self._refuse_prior(prior)
        xy = dot_numbers(xy_px)
        if xy.size == 0:
            xy = xy.reshape(0, 2)
        w = np.ones(xy.shape[:1]) if weights is None else dot_numbers(weights)
        if xy.ndim != 2 or xy.shape[1] != 2 or w.shape != (len(xy),):
            raise FrameError(f"dots of shape {xy.shape} with weights of shape {w.shape} do not match; give (n, 2) and (n,)")
        if not (np.isfinite(xy).all() and np.isfinite(w).all() and (w >= 0).all()):
            raise FrameError("dots have NaN or infinite values, or negative weights; leave those dots out")
        square = self._square.places(xy)
        if self._method == "paper":
            from tactape_fab.sense.decode.paper import locate_paper_dots

            # pixel centres 0 ... h - 1 are 0 ... aspect (h - 1) in square pixels: the centre is the same for both
            size = (self.sensor.width_px, (self.sensor.height_px - 1) * self._square.aspect + 1)
            found, _ = locate_paper_dots(square, self.tapes, size, px_per_mm=self._view.px_per_mm)
            found = self._of_design(found)
        else:
            found = self._locate(Dots(xy_px=square, weights=w, trust=trusted(w), seen_px=xy), prior)
        return _stamped(found, start, timestamp)

    @property
    def takes_prior(self) -> bool:
        """Whether `locate` can use a prior: only with method "ml" and registered tapes."""
        return self._method == "ml" and isinstance(self._world, Registry)

    def _refuse_prior(self, prior: object) -> None:
        if prior is None:
            return
        if not isinstance(prior, Prior):
            remedy = "give Prior(position_mm=fix.position_mm, theta_deg=fix.theta_deg)"
            raise SpecError(Problem("prior", f"prior = {shown(prior)} is a {type(prior).__name__}, not a Prior; {remedy}"))
        if self.takes_prior:
            if prior.tape is not None and prior.tape not in self._names:
                names = ", ".join(sorted(self._names)[:_MOST_NAMED]) + (", ..." if len(self._names) > _MOST_NAMED else "")
                message = (
                    f"prior.tape = {shown(prior.tape)} is the name of no registered tape; give one of {names}, or None for any"
                )
                raise SpecError(Problem("prior", message))
            return
        what = "method 'paper'" if self._method == "paper" else "a code without tapes"
        message = f"prior = {prior!r} cannot be used with {what}; leave it out, or register tapes with 'ml'"
        raise SpecError(Problem("prior", message))

    def _by_paper(self, image: npt.NDArray[np.float32]) -> Localization:
        from tactape_fab.sense.decode.paper import locate_paper

        found, _ = locate_paper(self._square.image(image), self.tapes, px_per_mm=self._view.px_per_mm)
        return self._of_design(found)

    def _of_design(self, found: Localization) -> Localization:
        """An answer of the paper's method as one of the registry."""
        world = self._world
        differ = [world.tapes[i] for i in world.boards_differ] if isinstance(world, Registry) else []
        board_mm = None if any((t.name, t.sector) == (found.tape, found.sector) for t in differ) else found.board_mm
        return replace(found, places="nominal", board_mm=board_mm) if found.located else found

    def _locate(self, dots: Dots, prior: Prior | None, image: Image | None = None, *, in_mm: bool = True) -> Localization:
        pixels = None if image is None or self._pixel_fit is None else Pixels(fit=self._pixel_fit, image=image)
        # `wrong_profile` looks at the dots under other scales: it needs them as detected
        raw = dots
        small = (image is not None and self._square.straight) or len(dots.weights) == 0 or np.abs(dots.xy_px).max() <= LARGE
        if small:
            dots = settled(dots, self._view.pitch_px, self._view.shift)
        if image is not None:
            dots = self._square.at_middles(dots, image, self._view.part)
        n = len(dots.weights)
        empty = partial(Localization, status=status_of(n), located=False, n_dots=n)
        if n < LEAST_DOTS:
            return empty(reason="no dots" if n == 0 else f"only {n} dots")
        if dots.trust.sum() < 1.0 or not small:
            return empty(reason="no dot stands out of the noise")
        reading = read(dots, self._view, self._world, prior, self._limits.on_tape, self._limits.precision)
        explained = False
        if reading is None:
            found = empty(reason="the dots stand on no grid of this pitch, or reach farther than a contact")
        else:
            pressed = None
            if image is not None and raw.small is not None:
                gel = self._contact_view if in_mm else replace(self._contact_view, rough=True)
                pressed = gel, image, raw.small
            sharper = None if raw.high is None else partial(self._square.shifts, self._view.part, raw.high)
            found, explained = accept_place(dots, reading, self._view, self._world, self._limits, pixels, pressed, sharper)
        if found.located or explained or n < SOLID_DOTS:
            return found
        negated = None if image is None else lambda: self._square.dots(-image)
        seen = Seen(sensor=self.sensor, view=self._view, world=self._world, limits=self._limits)
        return replace(found, reason=wrong_profile(seen, dots, raw, negated) or found.reason)


def _plane_of(code: Plane) -> CodePlane:
    if isinstance(code, TraceCode):
        return TracePlane(code, LARGEST_CONTACT)
    assert isinstance(code, PlaneCode)
    return SequencePlane(code, LARGEST_CONTACT)
