"""Units of mesh files: what their coordinates are multiplied by to be metres."""

from qdgrasp_protocol.errors import AssetError, ImpossibleValue, InputError, UnknownName

UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
"""Metres to a unit."""
WORDS = {"mm": "millimetres", "cm": "centimetres", "m": "metres", "in": "inches"}
LARGEST = 2.0
"""What a hand could grasp is smaller [m]."""
SMALLEST = 0.002
"""What a hand could grasp is larger [m]."""
MOST = 1_000_000
"""Metres to a unit, as a spec allows."""
MILLIMETRES = 10.0
"""A drawing that measures more of its units is hardly in another one."""
ROUNDING = 1e-6
"""Two scales that differ by a smaller share are the same."""


def scale_of(units: str | None, scale: float | None) -> float | None:
    """The scale that is meant where one of the two may be given; None: neither is.

    Raises
    ------
    UnknownName, ImpossibleValue, InputError
        There is no such unit, no mesh has that scale, or both are given.
    """
    if scale is not None and not 0 < scale <= MOST:
        expected = (
            f"a number greater than 0 and at most {MOST} (metres to a unit of the mesh file: 0.001 for mm)"
        )
        raise ImpossibleValue("--scale", scale, expected)
    if units is None:
        return scale
    if units not in UNITS:
        raise UnknownName("unit", units, UNITS, "Or say how many metres a unit of the file is with --scale.")
    if scale is not None:
        raise InputError(
            f"--units {units} means --scale {UNITS[units]:g}: give only one, --scale for any other size."
        )
    return UNITS[units]


def in_words(scale: float) -> str:
    """A scale as the flag that means it."""
    named = [unit for unit, metres in UNITS.items() if abs(scale / metres - 1) < ROUNDING]
    return f"--units {named[0]}" if named else f"--scale {scale:g}"


def advice(largest: float) -> str:
    """What to do about an object whose `largest` side [m], read in metres, is none that a hand grasps."""
    fitting = [unit for unit, metres in UNITS.items() if 2 * SMALLEST < largest * metres < LARGEST]
    if largest < LARGEST or not fitting:
        return "say how many metres a unit of the file is with --scale"
    likely = fitting[:1] if largest >= MILLIMETRES else fitting
    looks = " or ".join(WORDS[unit] for unit in likely)
    flags = " or ".join(f"--units {unit}" for unit in likely)
    return f"it looks like {looks}: add {flags}"


def check_stated(name: str, stated: float | None, scale: float | None) -> None:
    """Check that the unit that a file states itself is the one that it is read in.

    Parameters
    ----------
    name
        The file's.
    stated
        Metres to a unit, as the file says; None: it says nothing.
    scale
        What the user says; None: nothing, so that it would be read in metres.

    Raises
    ------
    AssetError
        The file says another unit than metres, and the user says nothing.
    """
    if stated is None or scale is not None or abs(stated - 1) < ROUNDING:
        return
    raise AssetError(
        f"The mesh '{name}' says that its unit is {stated:g} m, and meshes are read in metres: add "
        f"{in_words(stated)}, or --units m if it is wrong about that."
    )
