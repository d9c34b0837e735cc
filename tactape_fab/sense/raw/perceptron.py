"""A small perceptron for every pixel of an image, in single precision, so that compilers make vector instructions of it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tactape_fab.base.jit import inner_kernel, making_kernel

Floats = npt.NDArray[np.float32]

BLOCK = 256
"""Pixels that go through all layers together, so that the values between two layers stay in the cache."""


@inner_kernel(fastmath=True)
def _layer(inputs: Floats, outputs: Floats, weight: Floats, bias: Floats, n_in: int, n_out: int, rectified: bool) -> None:
    """Fill in outputs = weight @ inputs + bias, four neurons at a time; `rectified` clips negative ones to 0."""
    for j in range(0, n_out, 4):
        out0, out1, out2, out3 = outputs[j], outputs[j + 1], outputs[j + 2], outputs[j + 3]
        b0, b1, b2, b3 = bias[j], bias[j + 1], bias[j + 2], bias[j + 3]
        # always the whole block: loops of a known length vectorise, and the rest beyond the last pixel is never read
        for p in range(BLOCK):
            out0[p], out1[p], out2[p], out3[p] = b0, b1, b2, b3
        for k in range(0, n_in, 4):
            in0, in1, in2, in3 = inputs[k], inputs[k + 1], inputs[k + 2], inputs[k + 3]
            w = weight[j : j + 4, k : k + 4]
            w00, w01, w02, w03 = w[0, 0], w[0, 1], w[0, 2], w[0, 3]
            w10, w11, w12, w13 = w[1, 0], w[1, 1], w[1, 2], w[1, 3]
            w20, w21, w22, w23 = w[2, 0], w[2, 1], w[2, 2], w[2, 3]
            w30, w31, w32, w33 = w[3, 0], w[3, 1], w[3, 2], w[3, 3]
            for p in range(BLOCK):
                a, b, c, d = in0[p], in1[p], in2[p], in3[p]
                out0[p] += w00 * a + w01 * b + w02 * c + w03 * d
                out1[p] += w10 * a + w11 * b + w12 * c + w13 * d
                out2[p] += w20 * a + w21 * b + w22 * c + w23 * d
                out3[p] += w30 * a + w31 * b + w32 * c + w33 * d
        if rectified:
            zero = np.float32(0.0)
            for p in range(BLOCK):
                out0[p], out1[p] = max(out0[p], zero), max(out1[p], zero)
                out2[p], out3[p] = max(out2[p], zero), max(out3[p], zero)


@making_kernel(fastmath=True)
def of_pixels(image: npt.NDArray[np.uint8], weights: Floats, biases: Floats, widths: npt.NDArray[np.int64]) -> Floats:
    """The last layer's first two outputs for every pixel; inputs are blue, green, red, x and y, each from 0 to 1.

    image (h, w, 3): C-contiguous.
    weights (layers, m, m): Row j of layer i: what its neuron j takes of each input; zero beyond its widths.
    biases (layers, m)
    widths (layers + 1,): Inputs, and neurons of each layer, as multiples of four.
    Returns (2, h, w).
    """
    h, w = image.shape[0], image.shape[1]
    out = np.empty((2, h, w), dtype=np.float32)
    flat, flat_out = image.reshape(h * w, 3), out.reshape(2, h * w)
    buffer = np.zeros((2, weights.shape[1], BLOCK), dtype=np.float32)
    layers = len(weights)
    per_grey, per_w, per_h = np.float32(1.0 / 255.0), np.float32(1.0 / w), np.float32(1.0 / h)
    for start in range(0, h * w, BLOCK):
        count = min(BLOCK, h * w - start)
        now, then = buffer[0], buffer[1]
        for p in range(count):
            v, u = divmod(start + p, w)
            pixel = flat[start + p]
            now[0, p], now[1, p], now[2, p] = per_grey * pixel[0], per_grey * pixel[1], per_grey * pixel[2]
            # as gs_sdk trains: u / width and v / height
            now[3, p], now[4, p] = per_w * u, per_h * v
        for k in range(5, widths[0]):
            for p in range(BLOCK):
                now[k, p] = np.float32(0.0)
        for i in range(layers):
            _layer(now, then, weights[i], biases[i], widths[i], widths[i + 1], i + 1 < layers)
            now, then = then, now
        for p in range(count):
            flat_out[0, start + p], flat_out[1, start + p] = now[0, p], now[1, p]
    return out
