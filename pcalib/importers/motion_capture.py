"""A six-leg platform measured by motion capture.

CSV with a header and one row per pose:

    leg_length_1 … leg_length_6                      commands, in revolutions of each leg's motor
    position_x position_y position_z                 measured platform position [mm]
    orientation_x orientation_y orientation_z orientation_w    measured quaternion, scalar last

Other columns are not used. Every leg lengthens by its own travel per revolution; the platform stands at its home
height when all legs are at zero. The defaults are the nominal geometry of an open platform of this kind (Jugglebot).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pcalib import robot as robots
from pcalib import rotation
from pcalib.data import table
from pcalib.data.measurement import Measurements
from pcalib.importers import Imported, Importer, Option
from pcalib.mechanics import kinematics

LEGS = tuple(f"leg_length_{i}" for i in range(1, 7))
POSITION = tuple(f"position_{c}" for c in "xyz")
QUATERNION = tuple(f"orientation_{c}" for c in "wxyz")

FOREIGN = 0.1
"""Share of the home height by which positions must be off the drawing, in the middle, to be of another frame: a
platform whose legs are off by millimetres stays far below, one that counts from its home height or from the floor is
a whole height off."""
_ROBOT = """\
# A six-leg platform with legs commanded in motor revolutions, as drawn.
name = "platform"
kind = "hexapod"

[geometry]
base_radius_mm = {base_radius:.9g}
plate_radius_mm = {plate_radius:.9g}
home_height_mm = {home_height:.9g}
base_azimuth_deg = [{base_azimuth}]
plate_azimuth_deg = [{plate_azimuth}]
leg_travel_mm_rev = [{leg_travel}]

[joints]
min_rev = {low:.9g}
max_rev = {high:.9g}

[workspace]               # about what was measured
radius_mm = {radius:.9g}
z_min_mm = {z_min:.9g}
z_max_mm = {z_max:.9g}
tilt_deg = {tilt:.9g}
yaw_deg = {yaw:.9g}
"""


def read(path: Path, settings: Mapping[str, np.ndarray]) -> Imported:
    """Poses, and the platform as drawn.

    Raises:
        InputError: a column is missing, a cell is no number or a quaternion has not length 1.
    """
    content = table.read(path)
    for name in (*LEGS, *POSITION, *QUATERNION):
        if name not in content.columns:
            raise content.error(
                f"column '{name}' is missing", remedy=f"needed: {', '.join((*LEGS, *POSITION, *QUATERNION))}"
            )
    revolutions, position, quaternion = (
        np.stack([content.numbers(name) for name in names], axis=1) for names in (LEGS, POSITION, QUATERNION)
    )
    length = np.linalg.norm(quaternion, axis=1)
    if (np.abs(length - 1) > 1e-3).any():
        row = int(np.argmax(np.abs(length - 1)))
        raise content.error(
            f"the quaternion has length {length[row]:.6g}, not 1", row=row, column="orientation_w",
            remedy="the order is orientation_x, orientation_y, orientation_z, orientation_w",
        )
    R = rotation.from_quaternion(quaternion / length[:, None])
    drawn = _robot(path, settings, revolutions, position, R)
    solution = kinematics.forward(drawn.mechanism, drawn.mechanism.nominal, 2 * np.pi * revolutions)
    there, body = solution.pose.x[solution.ok], solution.pose.R[solution.ok]
    own = len(there) > 3 and np.median(np.linalg.norm(1e-3 * position[solution.ok] - there, axis=1)) > FOREIGN * float(
        settings["home_height"][0]
    )
    robot = _robot(path, settings, revolutions, 1e3 * there, body) if own else drawn
    data = Measurements.create(
        robot, 2 * np.pi * revolutions, 1e-3 * position, R,
        sigma_pos=float(settings["sigma_pos"][0]), sigma_rot=float(settings["sigma_rot"][0]), source=str(path),
        frame="tracker" if own else "base",
    )  # fmt: skip
    place = (
        "positions are those of the capture's own frame, which is not the robot's: frame = tracker" if own
        else "positions are taken to be in the robot's frame (frame = base); write frame = tracker where they are not"
    )
    notes = (
        f"σ is taken as {1e3 * settings['sigma_pos'][0]:.3g} mm and {np.degrees(settings['sigma_rot'][0]):.3g}° "
        "(sigma_pos=…, sigma_rot=…): instrument and repeatability of the legs together",
        place,
    )
    return Imported(data, robot, notes)


def _robot(
    path: Path, settings: Mapping[str, np.ndarray], revolutions: np.ndarray, position: np.ndarray, R: np.ndarray
) -> robots.Robot:
    def listed(values: np.ndarray) -> str:
        return ", ".join(f"{v:.12g}" for v in values)

    turn = rotation.to_quaternion(R)
    yaw = np.degrees(np.abs(2 * np.arctan2(turn[:, 3], turn[:, 0]))).max()
    tilt = np.degrees(np.arccos(np.clip(R[:, 2, 2], -1, 1))).max()
    z, spread = position[:, 2], np.ptp(position[:, 2])
    spare = 0.1 + 1e-6 * np.abs(revolutions).max()  # more than the file's digits leave out
    text = _ROBOT.format(
        **{name: 1e3 * settings[name][0] for name in ("base_radius", "plate_radius", "home_height")},
        base_azimuth=listed(np.degrees(settings["base_azimuth"]) % 360),
        plate_azimuth=listed(np.degrees(settings["plate_azimuth"]) % 360),
        leg_travel=listed(settings["leg_travel"] * 2e3 * np.pi),
        low=revolutions.min() - spare, high=revolutions.max() + spare,
        radius=1.02 * np.hypot(position[:, 0], position[:, 1]).max(), z_min=z.min() - 0.1 * spread - 1.0,
        z_max=z.max() + 0.1 * spread + 1.0, tilt=tilt + 1.0, yaw=yaw + 1.0,
    )  # fmt: skip
    return robots.parse(text, f"robot made from {path.name}")


_LEG = np.arange(6)
IMPORTER = Importer(
    name="motion-capture",
    summary="six leg commands in motor revolutions with the platform's measured position [mm] and quaternion, CSV",
    options={
        "base_radius": Option((410.0,), "mm", "base joints from the centre"),
        "plate_radius": Option((219.075,), "mm", "platform joints from the centre"),
        "home_height": Option((565.0,), "mm", "platform over base with all legs at zero"),
        "base_azimuth": Option(
            tuple((200.0 + 100.0 * (_LEG // 2) + 20.0 * ((_LEG + 1) // 2)).tolist()), "deg", "of the base joints"
        ),
        "plate_azimuth": Option(
            tuple((154.3012223 + 8.6024446 * (_LEG // 2) + 111.3975554 * ((_LEG + 1) // 2)).tolist()), "deg",
            "of the platform joints",
        ),
        "leg_travel": Option(
            tuple(1e3 / v for v in (13.21144, 14.0456, 13.8233, 14.124109, 14.16007, 14.03256)), "mm_rev",
            "lengthening per revolution of each motor",
        ),
        "sigma_pos": Option((0.4,), "mm", "1σ of a position, the robot's repeatability included"),
        "sigma_rot": Option((0.17,), "deg", "1σ of an orientation, the robot's repeatability included"),
    },
    read=read,
)  # fmt: skip
