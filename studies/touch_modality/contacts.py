"""The stress of a finger, a paintbrush and a washer in an elastic cover as they move over it.

Each tool is a few Gaussian contacts that move together, blurred by the cover, with loads that vary as for that
tool: skin that sticks and slips and whose ridges vibrate; tufts of bristles that catch at random; a rim that rolls on
two edges and is not quite round. Equations and sources: docs/touch-modality-simulator.md.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from pydantic import Field

from neurotact.spec import Spec

KPA_PER_N_PER_MM2 = 1000.0


class FingerSpec(Spec):
    """The pad of a sliding finger."""

    force_N: float = Field(default=0.84, gt=0)
    """Median force over people and touches."""
    pad_mm: float = Field(default=4.5, gt=0)
    """Standard deviation of the pad's pressure across the finger, median."""
    pad_spread: float = Field(default=0.2, ge=0, lt=1)
    """Spread of that width, as the deviation of its logarithm over people and touches: tip or flat pad."""
    elongation: float = Field(default=1.3, ge=1)
    """Length over width of the pad; its long side is in the direction of the stroke."""
    ridge_mm: float = Field(default=0.45, gt=0)
    """Distance of papillary ridges (0.4 to 0.5 mm on an adult finger)."""
    ridge_depth: float = Field(default=0.12, ge=0)
    """Share of the stress that vibrates as ridges pass."""
    stick_mm: float = Field(default=2.0, ge=1e-3)
    """Mean distance that the skin is dragged before it slips."""
    stick_depth: float = Field(default=0.3, ge=0, lt=1)
    """Share of the load that builds up while the skin sticks and is released when it slips."""


class BrushSpec(Spec):
    """A flat paintbrush."""

    force_N: float = Field(default=0.24, gt=0)
    """Median force over people and touches."""
    width_mm: float = Field(default=18.0, gt=0)
    """Width of the line of bristles, across the stroke, for a fully pressed brush."""
    width_spread: float = Field(default=0.3, ge=0, lt=1)
    """Spread of that width, as the deviation of its logarithm: orientation and pressure of the brush."""
    depth_mm: float = Field(default=3.0, gt=0)
    """Depth of the bundle along the stroke, standard deviation."""
    tufts: int = Field(default=14, ge=1, le=1000)
    """Bundles of bristles along the line."""
    tuft_mm: float = Field(default=1.5, gt=0)
    """Standard deviation of a tuft's pressure."""
    catch_depth: float = Field(default=0.8, ge=0)
    """Deviation of the logarithm of a tuft's load as its bristles catch and release."""
    catch_mm: float = Field(default=1.5, gt=0)
    """Distance over which a tuft's load is correlated."""
    rasp_depth: float = Field(default=0.35, ge=0)
    """Share of the stress that is broadband friction noise of single bristles."""


class WasherSpec(Spec):
    """A flat washer that rolls on its rim, held upright between two fingers."""

    force_N: float = Field(default=0.21, gt=0)
    """Median force over people and touches."""
    diameter_mm: float = Field(default=24.0, gt=0)
    """Outer diameter."""
    thickness_mm: float = Field(default=2.5, gt=0)
    """Distance of the rim's two edges, which are the lines of contact."""
    rim_mm: float = Field(default=1.0, gt=0)
    """Standard deviation of the pressure under one edge."""
    tilt: float = Field(default=0.5, ge=0, le=1)
    """Share of the load that shifts between the edges, once per revolution and with the hand."""
    oval_depth: float = Field(default=0.2, ge=0, lt=1)
    """Share of the load that changes twice per revolution, since the rim is not round."""
    lobes: int = Field(default=18, ge=1)
    """Burrs on the rim, each of which clicks at contact."""
    lobe_depth: float = Field(default=0.25, ge=0, lt=1)
    """Share of the load that differs between burrs."""


Tool = FingerSpec | BrushSpec | WasherSpec


class Motion(NamedTuple):
    """A stroke sample by sample: position along it, offset across it (mm), speed (mm/s), load (N); `(time,)` each."""

    along_mm: np.ndarray
    across_mm: np.ndarray
    speed_mm_per_s: np.ndarray
    load_N: np.ndarray
    sampling_rate_Hz: float

    @property
    def travelled_mm(self) -> np.ndarray:
        """Distance covered so far, back and forth."""
        return np.cumsum(np.abs(self.speed_mm_per_s)) / self.sampling_rate_Hz


class Contact(NamedTuple):
    """Gaussian contacts of one tool.

    share: of the load, `(time, contact)`; offsets from the tool's middle and deviations in mm, `(contact,)`;
    vibration: relative change of all stress, `(time,)`.
    """

    share: np.ndarray
    along_mm: np.ndarray
    across_mm: np.ndarray
    sd_along_mm: np.ndarray
    sd_across_mm: np.ndarray
    vibration: np.ndarray


def contact_stress(contact: Contact, motion: Motion, taxels_mm: np.ndarray, cover_mm: float) -> np.ndarray:
    """Stress (kPa) under the cover at each taxel, `(time, side * side)`, for taxels on a square grid.

    taxels_mm: coordinate of each row and column of the grid, `(side,)`. The stroke runs along the rows, so that the
        result is `along` fastest: taxel = side * (place across) + (place along).

    The stress integrates to the load for any widths: each contact is load / (2 pi s_a s_b) at its middle.
    """
    sd_along, sd_across = np.hypot(contact.sd_along_mm, cover_mm), np.hypot(contact.sd_across_mm, cover_mm)
    along = (motion.along_mm[:, None] + contact.along_mm)[:, :, None] - taxels_mm
    across = (motion.across_mm[:, None] + contact.across_mm)[:, :, None] - taxels_mm
    peak = KPA_PER_N_PER_MM2 * motion.load_N[:, None] * contact.share / (2.0 * np.pi * sd_along * sd_across)
    here_along = np.exp(-0.5 * (along / sd_along[:, None]) ** 2)
    here_across = peak[:, :, None] * np.exp(-0.5 * (across / sd_across[:, None]) ** 2)
    field = np.matmul(here_across.transpose(0, 2, 1), here_along).reshape(len(peak), -1)
    return field * (1.0 + contact.vibration[:, None])


def touch(tool: Tool, motion: Motion, width: float, rng: np.random.Generator) -> Contact:
    """The contacts of a tool along a motion; `width` is a standard normal number for the width of this touch."""
    contacts: dict[type, Callable[..., Contact]] = {FingerSpec: _finger, BrushSpec: _brush, WasherSpec: _washer}
    return contacts[type(tool)](tool, motion, width, rng)


def _finger(tool: FingerSpec, motion: Motion, width: float, rng: np.random.Generator) -> Contact:
    sd_mm = tool.pad_mm * np.exp(tool.pad_spread * width)
    way = motion.travelled_mm
    slips = np.cumsum(rng.exponential(tool.stick_mm, int(way[-1] / tool.stick_mm * 2) + 20))
    ends = np.concatenate([[0.0], slips])
    stick = np.minimum(np.searchsorted(ends, way, side="right"), len(ends) - 1)
    drag = (way - ends[stick - 1]) / (ends[stick] - ends[stick - 1])  # 0 after a slip to 1 before the next
    load = 1.0 + tool.stick_depth * (np.minimum(drag, 1.0) - 0.5)
    phase = 2.0 * np.pi * way / tool.ridge_mm + np.cumsum(rng.normal(0.0, 0.15, len(way)))
    vibration = tool.ridge_depth * np.sin(phase) * _rubbing(motion)
    one = np.zeros(1)
    return Contact(load[:, None], one, one, one + sd_mm * tool.elongation, one + sd_mm, vibration)


def _brush(tool: BrushSpec, motion: Motion, width: float, rng: np.random.Generator) -> Contact:
    half_mm = 0.5 * tool.width_mm * np.exp(tool.width_spread * width)
    across = np.linspace(-half_mm, half_mm, tool.tufts) if tool.tufts > 1 else np.zeros(1)
    along = rng.normal(0.0, tool.depth_mm, tool.tufts)
    # an Ornstein-Uhlenbeck process along the path: its correlation decays with distance, not with time
    keep = np.exp(-np.abs(motion.speed_mm_per_s) / motion.sampling_rate_Hz / tool.catch_mm)
    level = _fading_noise(keep, rng.standard_normal((len(keep), tool.tufts)))
    share = np.exp(tool.catch_depth * level - 0.5 * tool.catch_depth**2) / tool.tufts
    rasp = tool.rasp_depth * rng.standard_normal(len(keep)) * _rubbing(motion)
    sd = np.full(tool.tufts, tool.tuft_mm)
    return Contact(share, along, across, sd, sd, rasp)


def _washer(tool: WasherSpec, motion: Motion, width: float, rng: np.random.Generator) -> Contact:
    start, oval, lobe, sway = rng.uniform(0.0, 2.0 * np.pi, 4)
    angle = start + motion.along_mm / (0.5 * tool.diameter_mm)
    round_ = 1.0 + tool.oval_depth * np.sin(2.0 * angle + oval) + tool.lobe_depth * np.sin(tool.lobes * angle + lobe)
    # `width` tilts the whole roll to one edge, the angle shifts the load
    lean = np.clip(tool.tilt * (0.6 * np.sin(angle + sway) + 0.5 * width), -1.0, 1.0)
    share = round_[:, None] * 0.5 * np.stack([1.0 - lean, 1.0 + lean], axis=1)
    edges = 0.5 * tool.thickness_mm * np.array([-1.0, 1.0])
    sd = np.full(2, tool.rim_mm)
    return Contact(share, np.zeros(2), edges, sd, sd, np.zeros(len(angle)))


def _rubbing(motion: Motion) -> np.ndarray:
    """Friction noise only while the tool moves: 0 at rest, 1 at 40 mm/s, growing with the root of the speed."""
    return np.sqrt(np.abs(motion.speed_mm_per_s) / 40.0)


def _fading_noise(keep: np.ndarray, white: np.ndarray) -> np.ndarray:
    """x[t] = keep[t] x[t-1] + sqrt(1 - keep[t]^2) white[t], of unit variance throughout, `(time, column)`."""
    from scipy.signal import lfilter

    # In blocks of equal memory the recursion is a filter; speed changes little in 5 ms of human movement.
    level, state = np.empty_like(white), white[0]
    for first in range(0, len(white), 16):
        block = slice(first, first + 16)
        fade = float(keep[block].mean())
        level[block], _ = lfilter([np.sqrt(1.0 - fade**2)], [1.0, -fade], white[block], axis=0, zi=fade * state[None])
        state = level[block][-1]
    return level
