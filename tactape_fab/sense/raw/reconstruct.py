"""A colour image of a sensor's gel -> how far each point is pushed in, by the network that its maker or user calibrated.

The networks are those of gs_sdk (gs_sdk/gs_reconstruct.py, `BGRXYMLPNet`): blue, green and red of a pixel (0 to 255 as 0 to
1) and its place (u / width, v / height) go through fully connected layers ``fc1``, ``fc2``, ... with rectifiers between them; the
two outputs are angles in radians. Their tangents, less those of the image of the untouched gel, are slopes along u and v. The
networks are trained on pressed balls with the slopes dx / dz, dx from the ball's middle (calibration/prepare_data.py): of a
surface that falls where something is pressed in, so that depth is minus its integral.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from numbers import Real
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import FrameError, Problem, SpecError, refuse
from tactape_fab.base.fields import Fields, shown, shown_path
from tactape_fab.base.given_value import NO_ARRAY
from tactape_fab.base.libraries import library
from tactape_fab.sense.raw.perceptron import of_pixels
from tactape_fab.sense.raw.torch_file import read_tensors

Floats = npt.NDArray[np.float32]
Image = npt.NDArray[np.uint8]

INPUTS, OUTPUTS = 5, 2
MOST_LAYERS = 8
MOST_WIDTH = 256
FARTHEST_GREY = 20.0
"""Most grey levels, of 255, that the mean of a colour may be from that of the background: a contact moves it by a few, as its
slopes turn all ways. With a background that is a third darker angles were off by ten of their standard deviations."""
STEEPEST_RAD = np.float32(1.4)
"""Angles are clipped to this: no gel is as steep as 80 degrees, and the tangent diverges at 90."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Network:
    """A perceptron from the colours and place of a pixel to two angles, as `perceptron.of_pixels` takes it.

    Attributes
    ----------
    weights : ndarray of float32, shape (layers, m, m)
    biases : ndarray of float32, shape (layers, m)
    widths : ndarray of int64, shape (layers + 1,)
        Inputs, and neurons of each layer, as multiples of four; zeros fill them up.
    sizes : tuple of int
        The same as they are in the file.
    """

    weights: Floats
    biases: Floats
    widths: npt.NDArray[np.int64]
    sizes: tuple[int, ...]


def load_network(path: str | Path) -> Network:
    """A network from the weights that gs_sdk's calibration wrote (.pth), read without PyTorch.

    Parameters
    ----------
    path : str or Path
        A file of weights.

    Returns
    -------
    Network

    Raises
    ------
    SpecError
        When the file cannot be read, or its layers do not fit each other. Nothing in it is run.
    """
    tensors = read_tensors(path)
    count = len(tensors) // 2
    names = [f"fc{i + 1}.{what}" for i in range(count) for what in ("weight", "bias")]
    remedy = "give a network of gs_sdk: layers fc1, fc2, ... from blue, green, red, x, y to two angles"

    def refuse(what: str) -> SpecError:
        return SpecError(Problem("weights", f"weights {shown_path(path)} {what}; {remedy}"))

    if not 1 <= count <= MOST_LAYERS or sorted(tensors) != sorted(names):
        raise refuse(f"hold {shown(', '.join(sorted(tensors)))}, not weights and biases of 1 to {MOST_LAYERS} layers")
    layers = [(tensors[f"fc{i + 1}.weight"], tensors[f"fc{i + 1}.bias"]) for i in range(count)]
    sizes = [INPUTS]
    for i, (weight, bias) in enumerate(layers):
        if weight.ndim != 2 or weight.shape[1] != sizes[-1] or bias.shape != weight.shape[:1]:
            message = f"has weights of shape {weight.shape} and biases of shape {bias.shape} for {sizes[-1]} inputs"
            raise refuse(f"do not fit each other: fc{i + 1} {message}")
        sizes.append(len(bias))
    if sizes[-1] != OUTPUTS or not 1 <= min(sizes) <= max(sizes) <= MOST_WIDTH:
        raise refuse(f"are of a network with {' - '.join(map(str, sizes))} neurons, at most {MOST_WIDTH} are allowed in a layer")
    if not all(np.isfinite(tensor).all() for tensor in tensors.values()):
        raise refuse("hold values that are NaN or infinite")
    return make_network(layers)


def make_network(layers: Sequence[tuple[Floats, Floats]]) -> Network:
    """A network from (weight (n_out, n_in), bias (n_out,)) of each layer, which must fit each other."""
    sizes = (layers[0][0].shape[1], *(len(bias) for _, bias in layers))
    # rounded up: the kernel takes neurons and inputs four at a time, and zeros add nothing
    widths = np.array([-(-size // 4) * 4 for size in sizes], dtype=np.int64)
    weights = np.zeros((len(layers), widths.max(), widths.max()), dtype=np.float32)
    biases = np.zeros((len(layers), widths.max()), dtype=np.float32)
    for i, (weight, bias) in enumerate(layers):
        weights[i, : weight.shape[0], : weight.shape[1]] = weight
        biases[i, : len(bias)] = bias
    for array in (weights, biases, widths):
        array.setflags(write=False)
    return Network(weights=weights, biases=biases, widths=widths, sizes=sizes)


def slopes_of(image: Image, network: Network) -> Floats:
    """Slopes along u and v from an image; shape (2, h, w), without subtraction of the untouched gel's."""
    plain = np.require(image, np.uint8, ("C", "A", "W"))  # one that may not be written would be compiled for anew
    angles = of_pixels(plain, network.weights, network.biases, network.widths)
    np.clip(angles, -STEEPEST_RAD, STEEPEST_RAD, out=angles)
    return np.asarray(np.tan(angles, out=angles))


def integrated(slopes: Floats, px_per_mm: tuple[float, float]) -> Floats:
    """The least-squares surface of mean zero for given slopes.

    The step between two pixels is the mean of their slopes. The normal equations are Poisson's with Neumann's boundary, which
    a cosine transform makes diagonal (Strang, "The discrete cosine transform", SIAM Review 41, 1999).

    slopes (2, h, w): mm per mm along u and along v.
    px_per_mm: Along u and along v.
    Returns (h, w): mm.
    """
    fft = library("scipy.fft", "reading colour images")
    divergence = np.zeros(slopes.shape[1:], dtype=np.float32)
    u_steps = (slopes[0, :, 1:] + slopes[0, :, :-1]) * np.float32(0.5 / px_per_mm[0])
    v_steps = (slopes[1, 1:] + slopes[1, :-1]) * np.float32(0.5 / px_per_mm[1])
    # divergence: the step to the right minus the step from the left; no step crosses the border (Neumann)
    divergence[:, :-1] += u_steps
    divergence[:, 1:] -= u_steps
    divergence[:-1] += v_steps
    divergence[1:] -= v_steps
    spectrum = fft.dctn(divergence, norm="ortho", overwrite_x=True)
    spectrum *= _inverse_laplacian(*divergence.shape)
    return np.asarray(fft.idctn(spectrum, norm="ortho", overwrite_x=True))


@cache
def _inverse_laplacian(h: int, w: int) -> Floats:
    """Inverse eigenvalues of the five-point Laplacian in the cosine basis, 0 for the mean; shape (h, w)."""
    v, u = (4.0 * np.sin(np.pi * np.arange(n) / (2 * n)) ** 2 for n in (h, w))
    total = v[:, None] + u
    # slopes say nothing of the mean
    total[0, 0] = np.inf
    inverse = (-1.0 / total).astype(np.float32)
    inverse.setflags(write=False)
    return inverse


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reconstruction:
    """Depth maps of one sensor from its colour images: made once, by `make_reconstruction`.

    Attributes
    ----------
    network : Network
    untouched : ndarray of float32, shape (2, h, w)
        Slopes that the network sees in the image of the untouched gel.
    colour : ndarray, shape (3,)
        Mean blue, green and red of that image.
    px_per_mm : (float, float)
        Along u and v of the images.
    """

    network: Network
    untouched: Floats
    colour: npt.NDArray[np.float64]
    px_per_mm: tuple[float, float]

    def depth(self, image: npt.ArrayLike) -> Floats:
        """Depth map in the image's own orientation: indentation of each pixel in mm, mean zero, larger = further in.

        Parameters
        ----------
        image : array_like of uint8, shape (h, w, 3)
            Blue, green, red, as OpenCV reads files and cameras.

        Returns
        -------
        ndarray of float32, shape (h, w)

        Raises
        ------
        FrameError
            When it is no such image, not as large as the untouched one, or taken in another light.
        """
        picture = _checked(image, "image")
        h, w = self.untouched.shape[1:]
        if picture.shape[:2] != (h, w):
            found = f"{picture.shape[1]} x {picture.shape[0]} px"
            raise FrameError(f"an image of {found} is no match for a background of {w} x {h} px; crop and scale both alike")
        off = float(np.abs(picture.mean(axis=(0, 1)) - self.colour).max())
        if off > FARTHEST_GREY:
            message = (
                f"an image whose colours are {off:.0f} grey levels off the background's on the mean, more than {FARTHEST_GREY:g}"
            )
            raise FrameError(f"{message}, is of another light or camera; take the background anew")
        # slopes of the pressed gel less those of the untouched one, negated: depth is minus the surface
        return integrated(self.untouched - slopes_of(picture, self.network), self.px_per_mm)


def make_reconstruction(background: npt.ArrayLike, network: Network, px_per_mm: npt.ArrayLike) -> Reconstruction:
    """A reconstruction from the image of the untouched gel; its kernels are compiled now if they have not been.

    Parameters
    ----------
    background : array_like of uint8, shape (h, w, 3)
        Blue, green, red.
    network : Network
        From `load_network`.
    px_per_mm : float or (float, float)
        Scale of the images as the camera delivers them, px/mm: of both axes, or along their width and along their height.

    Returns
    -------
    Reconstruction

    Raises
    ------
    FrameError
        When the background is no such image.
    SpecError
        When the network is none, or the scale is not from 0.1 to 10,000 px/mm.
    """
    u_px, v_px = _read_scale(px_per_mm)
    if not isinstance(network, Network):
        raise SpecError(Problem("network", f"network = {shown(network)} is no network; give load_network(FILE.pth)"))
    picture = _checked(background, "background")
    colour = picture.mean(axis=(0, 1))
    colour.setflags(write=False)
    return Reconstruction(network=network, untouched=slopes_of(picture, network), colour=colour, px_per_mm=(u_px, v_px))


def _read_scale(px_per_mm: object) -> tuple[float, float]:
    """Scale along u and v; one number is that of both."""
    both = (px_per_mm, px_per_mm) if isinstance(px_per_mm, Real) else px_per_mm
    table = Fields({"px_per_mm": both.tolist() if isinstance(both, np.ndarray) else both})
    u_px, v_px = table.numbers("px_per_mm", 2, low=0.1, high=1e4, unit="px/mm", remedy="give px/mm, such as 16.0, or (u, v)")
    refuse(table.problems)
    return u_px, v_px


def _checked(image: npt.ArrayLike, what: str) -> Image:
    try:
        picture = np.asarray(image)
    except NO_ARRAY as error:
        raise FrameError(f"the {what} is no array: {error}; give uint8 (h, w, 3), blue first") from error
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or 0 in picture.shape:
        raise FrameError(f"the {what} is {picture.dtype} of shape {picture.shape}; give uint8 (h, w, 3), blue first")
    return picture
