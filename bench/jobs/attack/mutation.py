"""How a good file or option is damaged."""

from __future__ import annotations

import random

TOKENS = (
    "", ",", "\n", "\r", '"', "'", "#", "=", "# frame = tracker\n", "nan", "inf", "-1e308", "1e308", "1e-320", "1e999",
    "9" * 400, "9" * 5000, "1e29", "0", "-0", "-1", "1e6", "1_0", "٣", "\x00", "\ufeff", "\u2028", "\u202e", "\x1b[2J",
    "_mm", "_deg", "_furlong", "x_mm", "q1_rad", "q4_deg", "dir2", "set", "check", "qw", "rx_deg", "temp_arms_degC",
    "pose_id", "[", "]", "[[", "{", "}", "[geometry]", "[drive]\nripple_per_turn = ", 'kind = "planar"',
    'kind = "hexapod"', "true", "1979-05-27", "name.x", "a." * 100 + "a = 1", "[" * 3000, "x" * 3000, '"""', "\\", "\t",
    ";", "é", "distance_mm", "station", "from", "tilt_x_mrad", "tilt_y_mrad", "probe_mm", "surface", "sigma_z_mm",
    "# sigma_x_mm = 0", "# sigma_distance_um = 1e29", "# distance_offset = unknown", "# surface_A = sphere",
    "# station_A_mm = 1 2", "station.A", "rad", "Millimeters", "Rigid Body", "1e-9",
    "🤖", "null", "NaN", "-Infinity", "{}", "[]", ":",
)  # fmt: skip
"""Pieces that have broken some reader before."""
OPTION_VALUES = (
    "", "-1", "0", "1e308", "nan", "inf", "9" * 400, "9" * 5000, "1e29mm", "-1mm", "0mm", "1,2,3", "1,2,3mm",
    "0,0,-300mm", "5deg", "x\ny", "\x1b[31mred", "µ", "🤖", "absent.csv", "data.csv", "m.toml", ".", "/dev/null",
    "/dev/zero", "/", "a" * 5000, "nothing,nothing", "backlash", "backlash,backlash", "complete", "l11=-1,1mm",
    "\udcff\udcfe.csv", "--", "-",
)  # fmt: skip
"""Values of options and arguments."""


def damaged(good: bytes, dice: random.Random) -> bytes:
    """A file with pieces removed, repeated, swapped or replaced; one in seven is damaged byte by byte as well."""
    try:
        text = good.decode("utf-8")
    except UnicodeDecodeError:
        return _bytes_changed(good, dice)
    for _ in range(dice.choice([1, 1, 1, 2, 4])):
        text = _text_changed(text, dice)
    data = text.encode("utf-8", "surrogatepass")
    return _bytes_changed(data, dice) if dice.random() < 0.15 else data


def _text_changed(text: str, dice: random.Random) -> str:
    token, at = dice.choice(TOKENS), dice.randrange(len(text) + 1)
    to = min(len(text), at + dice.choice([1, 1, 2, 5, 40]))
    lines = text.split("\n")
    row = dice.randrange(len(lines))
    match dice.randrange(7):
        case 0:
            return text[:at] + text[to:]
        case 1:
            return text[:at] + token + text[at:]
        case 2:
            return text[:at] + token + text[to:]
        case 3:
            return "\n".join([*lines[:row], lines[dice.randrange(len(lines))], *lines[row:]])
        case 4:
            return "\n".join(lines[:row] + lines[row + 1 :])
    # One cell or value.
    separator = "," if "," in lines[row] and "=" not in lines[row] else "=" if "=" in lines[row] else ":"
    cells = lines[row].split(separator)
    value = token if dice.random() < 0.7 else repr(dice.gauss(0, 1) * 10.0 ** dice.randint(-12, 12))
    cells[dice.randrange(len(cells))] = value
    lines[row] = separator.join(cells)
    return "\n".join(lines)


def _bytes_changed(data: bytes, dice: random.Random) -> bytes:
    for _ in range(dice.randint(1, 3)):
        at = dice.randrange(len(data) + 1)
        match dice.randrange(4):
            case 0:
                data = data[:at]
            case 1:
                data = data[:at] + data[at + dice.randint(1, 30) :]
            case _:
                data = data[:at] + bytes([dice.randrange(256)]) + data[at + dice.randrange(2) :]
    return data


def odd_options(arguments: list[str], dice: random.Random) -> list[str]:
    """A command line with values replaced, repeated or left out."""
    out = list(arguments)
    for _ in range(dice.randint(1, 2)):
        at = dice.randrange(1, len(out)) if len(out) > 1 else 0
        match dice.randrange(4):
            case 0:
                del out[at:at + 1]
            case 1:
                out.insert(at, dice.choice(OPTION_VALUES))
            case _:
                out[at] = dice.choice(OPTION_VALUES)
    return out
