"""The tables of an experiment file. Lengths in mm, times in s, angles in degrees, as every key says.

Unknown keys, text where a number belongs, NaN and infinities are errors. Numbers are not guessed from text.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    WithJsonSchema,
    model_validator,
)

from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.experiment.lens_blur import BlurMm
from plenopiv.experiment.windows import Window, Windows
from plenopiv.reconstruction.settings import CandidateRule, LightFieldMethod, ReconstructionSettings, Weights

FARTHEST_PX = 1e6  # corners of polygons
SMALLEST, LARGEST = 1e-9, 1e9  # of all numbers with a unit: what lies outside is a wrong unit, or a damaged file
LONGEST_NAME = 4096  # bytes of a path


def _in_range(value: float) -> float:
    if value and not SMALLEST <= abs(value) <= LARGEST:
        raise ValueError(f"{value:g} is not between {SMALLEST:g} and {LARGEST:g}; is the unit that of the key's name?")
    return value


def _file_name(value: str) -> str:
    if "\0" in value:
        raise ValueError(f"{value[:40]!r} holds a NUL, which no file name has")
    if len(value.encode()) > LONGEST_NAME:
        raise ValueError(f"has {len(value)} letters, more than a file name can have")
    return value


Number = Annotated[float, AfterValidator(_in_range)]
PositiveFloat = Annotated[float, Field(gt=0), AfterValidator(_in_range)]
NotNegative = Annotated[float, Field(ge=0), AfterValidator(_in_range)]
# Strict models refuse lists for tuples; numbers inside stay strict.
Pair = Annotated[tuple[Number, Number], Field(strict=False)]
Triple = Annotated[tuple[Number, Number, Number], Field(strict=False)]
PositiveTriple = Annotated[tuple[PositiveFloat, PositiveFloat, PositiveFloat], Field(strict=False)]


class Table(BaseModel):
    """A table of the file: keys as declared and no others, finite numbers, read-only."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True, strict=True, populate_by_name=True)


def _frames(value: Any) -> str | tuple[str, ...]:
    if isinstance(value, str) and value:
        return _file_name(value)
    if isinstance(value, list | tuple) and all(isinstance(name, str) and name for name in value):
        if len(value) < 2:
            raise ValueError(f"{len(value)} frame given; a velocity needs at least two")
        return tuple(map(_file_name, value))
    raise ValueError('must be a list of file names, or a glob such as "run7/*.tif"')


def _pairs(value: Any) -> str | tuple[tuple[str, str], ...]:
    if isinstance(value, str) and value:
        return _file_name(value)
    if isinstance(value, list | tuple) and value:
        twos = [tuple(pair) for pair in value if isinstance(pair, list | tuple)]
        if len(twos) == len(value) and all(len(t) == 2 and all(isinstance(n, str) and n for n in t) for t in twos):
            return tuple((_file_name(a), _file_name(b)) for a, b in twos)
    raise ValueError('must be a pattern such as "run_*_{a,b}.tif", or a list of [first, second] file names')


def _background(value: Any) -> str | tuple[str, ...]:
    if value in ("mean", "median"):
        raise ValueError(
            f'"{value}" would take light of particles off with the static light; use "minimum", or images of '
            "static light"
        )
    if isinstance(value, str) and value:
        return value if value in ("none", "minimum") else (_file_name(value),)
    if isinstance(value, list | tuple) and len(value) in (1, 2) and all(isinstance(n, str) and n for n in value):
        return tuple(map(_file_name, value))
    raise ValueError(
        'must be "none", "minimum" (of the frames themselves), an image of the static light, or two, one for each pulse'
    )


def _mask(value: Any) -> str | tuple[tuple[tuple[float, float], ...], ...]:
    if isinstance(value, str) and value:
        return _file_name(value)
    if isinstance(value, list | tuple) and value and all(_is_polygon(each) for each in value):
        return tuple(tuple((float(column), float(row)) for column, row in each) for each in value)
    raise ValueError(
        "must be an image of a frame's size, 0 where it is masked, or a list of polygons, each of three or more "
        "corners [column, row]: [[[0, 0], [80, 0], [80, 60]]]"
    )


def _is_polygon(value: Any) -> bool:
    if not isinstance(value, list | tuple) or len(value) < 3:
        return False
    corners = all(isinstance(corner, list | tuple) and len(corner) == 2 for corner in value)
    return corners and all(type(n) in (int, float) and abs(n) <= FARTHEST_PX for corner in value for n in corner)


FileName = Annotated[str, Field(min_length=1), AfterValidator(_file_name)]
STRING_OR_ARRAY = WithJsonSchema({"type": ["string", "array"]})


class MainLensTable(Table):
    """``[camera.main_lens]``: a thin lens.

    ``f_number`` is the number engraved on the lens, N = focal_length/aperture (the lens focused at infinity), not the
    working f-number S_i/aperture. Give ``aperture_mm`` or ``f_number``, not both. ``blur_mm``: that of
    ``cameras.plenoptic.PlenopticCamera``; "auto": as the particles of the first pair show it.
    """

    focal_length_mm: PositiveFloat
    aperture_mm: PositiveFloat | None = None
    f_number: PositiveFloat | None = None
    magnification: Number
    blur_mm: BlurMm = 0.0

    @model_validator(mode="after")
    def _consistent(self) -> MainLensTable:
        if (self.aperture_mm is None) == (self.f_number is None):
            raise ValueError("give exactly one of aperture_mm and f_number")
        if self.magnification >= 0:
            raise ValueError(
                f"magnification = {self.magnification:g} must be negative, because a real image is inverted"
            )
        return self

    @property
    def diameter_mm(self) -> float:
        """Aperture P_m in mm, from whichever of the two keys was given."""
        if self.aperture_mm is not None:
            return self.aperture_mm
        assert self.f_number is not None
        return self.focal_length_mm / self.f_number


class MicrolensArrayTable(Table):
    """``[camera.microlens_array]``. Rotation and offset place the lattice where there is no white image.

    ``rotation_deg`` is counter-clockwise in the microlens plane (s, t), ``offset_mm`` the (s, t) of one microlens from
    the optical axis. A run with a white image finds both there and ignores these.
    """

    lattice: Literal["square", "hexagonal"]
    pitch_mm: PositiveFloat
    focal_length_mm: PositiveFloat
    rotation_deg: Annotated[float, Field(ge=-180, le=180)] | None = None
    offset_mm: Pair | None = None


class SensorTable(Table):
    """``[camera.sensor]``: pixels, bit depth, the count of a dark pixel, and in which of 16 bits files hold counts."""

    columns: Annotated[int, Field(ge=16, le=65536)]
    rows: Annotated[int, Field(ge=16, le=65536)]
    pixel_pitch_mm: PositiveFloat
    bit_depth: Annotated[int, Field(ge=8, le=16)]
    black_level: NotNegative = 0.0
    alignment: Literal["low", "high"] = "low"

    @model_validator(mode="after")
    def _consistent(self) -> SensorTable:
        if self.black_level >= 2**self.bit_depth - 1:
            raise ValueError(f"black_level = {self.black_level:g} is not below full scale, 2^{self.bit_depth} - 1")
        return self


def _unfocused(value: Any) -> Any:
    if isinstance(value, str) and value != "plenoptic":
        raise ValueError(
            f'{value!r}: only "plenoptic" is supported, a monochrome camera whose sensor lies one focal length behind '
            "its microlenses; focused (plenoptic 2.0), multi-focus and Bayer cameras are not"
        )
    return value


class CameraTable(Table):
    """``[camera]``."""

    kind: Annotated[Literal["plenoptic"], BeforeValidator(_unfocused)]
    main_lens: MainLensTable
    microlens_array: MicrolensArrayTable
    sensor: SensorTable


class TargetPlaneTable(Table):
    """One of ``calibration.planes``: an image of the target, and the traverse's reading."""

    image: FileName
    z_mm: Number


class CalibrationTable(Table):
    """``[calibration]``: images of a target of dots at known z (``calibration.target.board.Board``).

    x, y and z of results are then the target's, unless ``origin_mm`` puts their origin elsewhere in its frame, and
    ``turn_deg`` turns their axes about its z; neither makes a new calibration necessary.
    """

    target: Literal["dots"]
    pitch_mm: PositiveFloat
    dot_mm: PositiveFloat
    origin_dot_mm: PositiveFloat | None = None
    x_dot_mm: PositiveFloat | None = None
    step_mm: Number = 0.0
    planes: Annotated[tuple[TargetPlaneTable, ...], Field(strict=False, min_length=2)]
    origin_mm: Triple = (0.0, 0.0, 0.0)
    turn_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0

    @model_validator(mode="after")
    def _consistent(self) -> CalibrationTable:
        if self.origin_dot_mm is None:
            raise ValueError("origin_dot_mm is missing: the target's one large dot tells where x = y = 0 is")
        for key, width in (("origin_dot_mm", self.origin_dot_mm), ("x_dot_mm", self.x_dot_mm)):
            if width is not None and width <= self.dot_mm:
                raise ValueError(f"{key}: {width:g} mm is not wider than the other dots, dot_mm = {self.dot_mm:g}")
        if self.x_dot_mm is not None and self.x_dot_mm >= self.origin_dot_mm:
            raise ValueError("x_dot_mm: must be less than origin_dot_mm, so that the two are told apart")
        if max(self.dot_mm, self.origin_dot_mm) >= self.pitch_mm:
            raise ValueError(f"dot_mm, origin_dot_mm: dots {self.pitch_mm:g} mm apart would overlap")
        return self


class RecordingTable(Table):
    """``[recording]``: image files, relative to the experiment file, and the time from one frame to the next.

    Either ``frames``, a sequence ``dt_s`` apart, or ``pairs`` of a double-frame camera, ``dt_s`` between the two
    (``recording.pairs``). ``dark``: an image with the sensor covered. ``background``: an image of the static light, or
    one for each pulse (``recording.static_light``), or "minimum" of the frames themselves (``recording.background``).
    ``mask``: an image that is 0, or polygons, where pixels shall not be used (``recording.masks``). ``orientation`` has
    no default: a wrong one turns every velocity by 180 degrees without a sign of it. ``drift``: whether microlenses
    that have moved since the white image was taken are followed (``calibration.drift``).
    """

    white: FileName | None = None
    frames: Annotated[str | tuple[str, ...], PlainValidator(_frames), STRING_OR_ARRAY] | None = None
    pairs: Annotated[str | tuple[tuple[str, str], ...], PlainValidator(_pairs), STRING_OR_ARRAY] | None = None
    stacked: Literal["top-first", "bottom-first"] | None = None
    dark: FileName | None = None
    background: Annotated[str | tuple[str, ...], PlainValidator(_background), STRING_OR_ARRAY] = "none"
    mask: Annotated[str | tuple[Any, ...], PlainValidator(_mask), STRING_OR_ARRAY] | None = None
    dt_s: PositiveFloat
    orientation: Literal["upright", "sensor"]
    drift: Literal["auto", "none"] = "auto"

    @model_validator(mode="after")
    def _one_of_both(self) -> RecordingTable:
        if (self.frames is None) == (self.pairs is None):
            raise ValueError("give exactly one of frames (a sequence, dt_s apart) and pairs (dt_s between the two)")
        if self.stacked is not None and not isinstance(self.pairs, str):
            raise ValueError('stacked goes with pairs = "run_*.tif", whose images hold both pulses')
        return self


class VolumeTable(Table):
    """``[volume]``: outer faces, in the object frame (z = 0 the focal plane, + toward the camera).

    ``unseen``: whether parts that no view sees are an error or stay empty. ``body``: an STL file, in mm in the object
    frame, of what is solid (``body``).
    """

    x_mm: Pair
    y_mm: Pair
    z_mm: Pair
    voxel_mm: PositiveTriple
    unseen: Literal["error", "empty"] = "error"
    body: FileName | None = None

    @model_validator(mode="after")
    def _consistent(self) -> VolumeTable:
        for name in ("x_mm", "y_mm", "z_mm"):
            lo, hi = getattr(self, name)
            if not lo < hi:
                raise ValueError(f"the lower limit of {name} = [{lo:g}, {hi:g}] is not below the upper one")
        return self


class ReconstructionTable(Table):
    """``[reconstruction]``: keys and defaults of ``reconstruction.settings.ReconstructionSettings``.

    ``threshold`` (counts above the black level) is chosen by the program where absent.
    """

    method: LightFieldMethod = "drt-mart"
    iterations: Annotated[int, Field(ge=1, le=1000)] = ReconstructionSettings.iterations
    relaxation: Annotated[float, Field(gt=0, le=1)] = ReconstructionSettings.relaxation
    weights: Weights = ReconstructionSettings.weights
    candidates: CandidateRule = ReconstructionSettings.candidates
    threshold: NotNegative | None = None
    focus_reach: NotNegative = ReconstructionSettings.focus_reach
    seed: Annotated[int, Field(ge=0, lt=2**63)] = ReconstructionSettings.seed
    motion_tracking: Annotated[int, Field(ge=0, le=3)] = ReconstructionSettings.motion_tracking

    def settings(self) -> ReconstructionSettings:
        """The same as the reconstruction takes it."""
        return ReconstructionSettings(**self.model_dump())


class CorrelationTable(Table):
    """``[correlation]``: windows in voxels along x, y, z, coarse to fine, and their overlap as a fraction.

    The other keys and their limits are those of ``displacement.settings.CorrelationSettings``.
    """

    windows: Windows
    overlap: float = CorrelationSettings.overlap
    inner_window: Window | None = CorrelationSettings.inner_window
    inner_overlap: float = CorrelationSettings.inner_overlap
    coarse_passes: int = CorrelationSettings.coarse_passes
    fine_passes: int = CorrelationSettings.fine_passes
    smoothing_voxels: Number | Triple = CorrelationSettings.smoothing_voxels
    taper_voxels: float = CorrelationSettings.taper_voxels
    intensity_exponent: float = CorrelationSettings.intensity_exponent
    whitening: float = CorrelationSettings.whitening
    agreement: float = CorrelationSettings.agreement
    search: float = CorrelationSettings.search
    residual_search: float = CorrelationSettings.residual_search
    outlier_threshold: float = CorrelationSettings.outlier_threshold
    outlier_floor_voxels: float = CorrelationSettings.outlier_floor_voxels
    filter_predictor: bool = CorrelationSettings.filter_predictor

    def settings(self) -> CorrelationSettings:
        """The same as the correlation takes it.

        Raises:
            PlenoPIVError: a value is out of range.
        """
        return CorrelationSettings(**self.model_dump())


class OutputTable(Table):
    """``[output]``: the results folder, relative to the experiment file; whether it takes volumes and gradients too."""

    directory: FileName = "results"
    volumes: bool = False
    gradients: bool = False
