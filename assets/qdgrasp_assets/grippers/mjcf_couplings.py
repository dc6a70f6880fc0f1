"""Joints of a MuJoCo model that follow others, and the actuators that drive them.

Equalities, linkages that close loops, tendons and springs couple joints. A leader, which is a joint with a
motor, is moved through its range; the joints that are coupled with it go where MuJoCo's equalities are met
and springs are least strained. Their positions are then written as linear functions of the leader.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import Floats
from qdgrasp_assets.grippers.hand_model import MimicJoint
from qdgrasp_protocol.text import first_few, quoted

TENDON_WEIGHT, SHARE_WEIGHT, SPRING_WEIGHT, REST_WEIGHT = 0.1, 1e-2, 1e-4, 1e-6
"""Weights beside 1 of an equality: each term is met as far as those before it allow."""
SLACK_SHARE = 0.25
"""A tendon couples joints if its limits leave one of them at most this share of its range."""
POSITIONS = 11  # Positions of a leader at which its followers are found
OPEN_LOOP = 1e-3  # Equalities left open by more are not met [rad, m of the joint that moves them most]
LEAST_FITTED = 3  # Positions of a follower between its limits that are enough for a fit to these alone
LEAST_CLOSED = 0.5  # Share of the leader's positions at which equalities are to be met
COUPLED = 1e-3  # Least change with a joint, beside the greatest one, that counts
STEP = 1e-6  # Change of a joint over which lengths are differentiated [m, rad]
SEED, JITTER = 0, 0.1
"""For the posture in which couplings are found: away from the first by this share of the ranges."""
UNLIMITED = np.pi / 2  # Range of a joint without limits, to both sides [m, rad]
EXACT = 1e-4  # Deviation of a follower that is not reported [m, rad]
DECIMALS = 5  # of multipliers and offsets
MOST_NAMED = 8  # Most joints named in a sentence


class Mechanism:
    """The hinges and slides of a compiled `mujoco.MjModel`, n joints; others stand still."""

    def __init__(self, model: Any, names: Sequence[str]) -> None:
        """Take the names of all joints of the model, by number."""
        import mujoco

        self.model, self._data, self._mujoco = model, mujoco.MjData(model), mujoco
        moving = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
        self.joints = [n for n in range(model.njnt) if mujoco.mjtJoint(model.jnt_type[n]) in moving]
        """Numbers of the joints in the model."""
        self.names = [names[joint] for joint in self.joints]
        self._addresses = [int(model.jnt_qposadr[joint]) for joint in self.joints]
        self.home = np.array(model.qpos0[self._addresses])
        """(n,): positions in the posture in which the file draws the hand [m, rad]."""
        limited = model.jnt_limited[self.joints].astype(bool)[:, None]
        around = self.home[:, None] + [-UNLIMITED, UNLIMITED]
        self.ranges = np.where(limited, model.jnt_range[self.joints], around)
        """(n, 2): limits [m, rad]; around `home` for joints without."""

    def positions(self, joint: int) -> Floats:
        """Return positions (s,) from one limit of a joint to the other [m, rad]."""
        low, high = self.ranges[joint].tolist()
        return np.linspace(low, high, POSITIONS)

    def measure(self, positions: Floats) -> tuple[Floats, Floats]:
        """Return errors of equalities (e,) and lengths of tendons (t,), at positions (n,)."""
        data, mujoco = self._data, self._mujoco
        data.qpos[:] = self.model.qpos0
        data.qpos[self._addresses] = positions
        for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_tendon, mujoco.mj_makeConstraint):
            compute(self.model, data)
        return data.efc_pos[: data.ne].copy(), data.ten_length.copy()

    def gradients(self) -> tuple[Floats, Floats]:
        """Return how the results of `measure` change with joints, (e, n) and (t, n), near `home`."""
        jitter = JITTER * np.random.default_rng(SEED).uniform(-1, 1, len(self.joints))
        place = self.home + jitter * np.ptp(self.ranges, axis=1)
        equalities, lengths = self.measure(place)
        rows = np.zeros((len(equalities), len(place))), np.zeros((len(lengths), len(place)))
        for joint, step in enumerate(STEP * np.eye(len(place))):
            for row, up, down in zip(
                rows, self.measure(place + step), self.measure(place - step), strict=True
            ):
                row[:, joint] = (up - down) / (2 * STEP)
        return rows

    def equality_numbers(self) -> NDArray[Any]:
        """Return the number of the equality of each row of `measure` (e,)."""
        self.measure(self.home)
        return np.array(self._data.efc_id[: self._data.ne])

    def motors(self) -> Iterator[tuple[int, int, bool]]:
        """Yield actuators with the joint, or the tendon, that they move, and whether it is a tendon."""
        kinds = self._mujoco.mjtTrn
        for actuator in range(self.model.nu):
            target = int(self.model.actuator_trnid[actuator, 0])
            match kinds(self.model.actuator_trntype[actuator]):
                case kinds.mjTRN_TENDON:
                    yield actuator, target, True
                case kinds.mjTRN_JOINT | kinds.mjTRN_JOINTINPARENT if target in self.joints:
                    yield actuator, self.joints.index(target), False

    def led_by_equality(self) -> set[int]:
        """Return the joints that equalities of two joints name as the one that follows."""
        model = self.model
        rows = (model.eq_type == int(self._mujoco.mjtEq.mjEQ_JOINT)) & (model.eq_obj2id >= 0)
        return {self.joints.index(joint) for joint in model.eq_obj1id[rows] if joint in self.joints}

    def tendons_in_equalities(self) -> set[int]:
        """Return the tendons whose lengths equalities set."""
        model = self.model
        rows = model.eq_type == int(self._mujoco.mjtEq.mjEQ_TENDON)
        return {int(number) for ends in (model.eq_obj1id, model.eq_obj2id) for number in ends[rows]} - {-1}


def efforts(mechanism: Mechanism) -> Floats:
    """Return the greatest force or torque of joints (n,) [N, Nm] that is stated; 0: none."""
    model, (_, tendons), found = mechanism.model, mechanism.gradients(), np.zeros(len(mechanism.joints))
    for actuator, target, is_tendon in mechanism.motors():
        arms = tendons[target] if is_tendon else np.eye(len(found))[target]
        found += _greatest_force(model, actuator) * abs(model.actuator_gear[actuator, 0]) * np.abs(arms)
    bounds = np.abs(model.jnt_actfrcrange[mechanism.joints]).max(axis=1, initial=0)
    stated = np.where(found > 0, np.minimum(found, bounds), bounds)
    return np.where(model.jnt_actfrclimited[mechanism.joints], stated, found)


def _greatest_force(model: Any, actuator: int) -> float:
    """Return an actuator's greatest force before its gear; 0 where none is stated."""
    if model.actuator_forcelimited[actuator]:
        return float(np.abs(model.actuator_forcerange[actuator]).max())
    if model.actuator_ctrllimited[actuator] and not model.actuator_biasprm[actuator].any():  # a motor
        gain = abs(model.actuator_gainprm[actuator, 0])
        return float(gain * np.abs(model.actuator_ctrlrange[actuator]).max())
    return 0.0


def command_ranges(mechanism: Mechanism) -> dict[int, tuple[float, float]]:
    """Return the positions [rad, m] to which actuators may send joints."""
    model, found = mechanism.model, {}
    for actuator, joint, is_tendon in mechanism.motors():
        gear, sends = model.actuator_gear[actuator, 0], model.actuator_biasprm[actuator, 1] < 0
        if sends and not is_tendon and gear > 0 and model.actuator_ctrllimited[actuator]:
            low, high = model.actuator_ctrlrange[actuator] / gear
            found[joint] = (float(low), float(high))
    return found


class Couplings(NamedTuple):
    """The joints of a model that follow others or are moved by actuators."""

    mimics: dict[str, MimicJoint]
    """Followers by name."""
    moved: frozenset[str]
    """Joints that actuators move, by themselves or by tendons."""
    notes: tuple[str, ...]
    """How followers were found."""


def find_couplings(mechanism: Mechanism) -> Couplings:
    """Find the joints that follow others."""
    rows, found, notes = _CouplingRows(mechanism), {}, []
    names = mechanism.names
    for group in rows.groups():
        leaders = rows.leaders(group)
        followers = [joint for joint in group if joint not in leaders]
        if not followers:
            continue
        if len(leaders) != 1:
            why = f"{len(leaders)} motors move what it joins" if leaders else "it lets none of them move"
            notes.append(_left_free(names, followers, why))
            continue
        positions, closed = rows.sweep(leaders[0], followers)
        if closed.mean() < LEAST_CLOSED:
            why = "it is met in less than half of the range of what drives it"
            notes.append(_left_free(names, followers, why))
            continue
        values = mechanism.positions(leaders[0])[closed]
        mimics, worst = {}, 0.0
        for joint, places in zip(followers, positions[closed].T, strict=True):
            multiplier, offset, error = _fit(mechanism, joint, values, places)
            mimics[names[joint]] = MimicJoint(names[leaders[0]], multiplier, offset)
            worst = max(worst, error)
        found.update(mimics)
        notes.append(_followed(mimics, worst))
    return Couplings(found, frozenset(names[joint] for joint in rows.moved), tuple(notes))


def _fit(mechanism: Mechanism, joint: int, values: Floats, places: Floats) -> tuple[float, float, float]:
    """Fit a joint's places (s,) by a linear function of its leader's (s,).

    Returns multiplier, offset and greatest error; a joint at a limit is taken to be kept there.
    """
    low, high = mechanism.ranges[joint]
    between = (places > low + EXACT) & (places < high - EXACT)
    used = between if between.sum() >= LEAST_FITTED else np.ones_like(between)
    multiplier, offset = (
        round(float(each), DECIMALS) + 0.0 for each in np.polyfit(values[used], places[used], 1)
    )
    error = np.abs(np.clip(multiplier * values + offset, low, high) - places).max()
    return multiplier, offset, float(error)


def _followed(mimics: dict[str, MimicJoint], deviation: float) -> str:
    them = [
        f"'{name}' ({each.multiplier:g} times it{f', plus {each.offset:g}' if each.offset else ''})"
        for name, each in mimics.items()
    ]
    leader = next(iter(mimics.values())).leader
    about = f", to within {deviation:.2g} rad or m" if deviation > EXACT else ""
    return (
        f"{first_few(them, MOST_NAMED)} follow{'s' if len(them) == 1 else ''} '{leader}', as equalities, "
        f"linkages or tendons of the file couple them{about}"
    )


def _left_free(names: Sequence[str], followers: Iterable[int], why: str) -> str:
    words = first_few(quoted(names[joint] for joint in followers), MOST_NAMED)
    return (
        f"the coupling of {words} is not kept, as {why}: each moves by itself, unless a <mimic> that you add "
        "to the URDF that is written says how it follows"
    )


class _CouplingRows:
    """Couplings of the joints of a mechanism, as rows (r, n) of greatest entry 1."""

    def __init__(self, mechanism: Mechanism) -> None:
        self._mechanism, model = mechanism, mechanism.model
        equalities, tendons = mechanism.gradients()
        self._equality_scale = _scale(equalities, mechanism.equality_numbers())
        self._tendon_scale = _scale(tendons, np.arange(len(tendons)))
        equalities, tendons = (
            equalities * self._equality_scale[:, None],
            tendons * self._tendon_scale[:, None],
        )
        touched = np.abs(tendons) > COUPLED
        motors = list(mechanism.motors())
        pulled = [tendon for _, tendon, is_tendon in motors if is_tendon]
        driven = {joint for _, joint, is_tendon in motors if not is_tendon}
        self._driven = driven | {int(touched[n].argmax()) for n in pulled if touched[n].sum() == 1}
        self.moved = self._driven | {int(joint) for n in pulled for joint in np.flatnonzero(touched[n])}
        """Joints that actuators move, by themselves or by tendons."""
        couples = touched.sum(axis=1) > 1
        widths = np.ptp(model.tendon_range, axis=1) * self._tendon_scale
        ways = (np.abs(tendons) * np.ptp(mechanism.ranges, axis=1)).max(axis=1, initial=0.0)
        is_tight = model.tendon_limited.astype(bool) & (widths <= SLACK_SHARE * ways)
        is_tight[list(mechanism.tendons_in_equalities())] = False
        self._tight = np.flatnonzero(couples & is_tight)
        idle = [joint not in self._driven for joint in range(len(mechanism.joints))]
        self._sprung = np.flatnonzero(couples & (model.tendon_stiffness > 0) & touched[:, idle].any(axis=1))
        self._shares = np.concatenate(
            [np.zeros((0, len(idle))), *(self._share(tendons[n]) for n in pulled if couples[n])]
        )
        self._equalities = equalities
        self._fixed = np.concatenate([equalities, tendons[self._tight], self._shares])
        self._rows = np.concatenate([self._fixed, tendons[self._sprung]])

    def _share(self, arms: Floats) -> Floats:
        """Return rows that say how a pull moves joints: by arm, over stiffness if all have one."""
        stiffness = self._mechanism.model.jnt_stiffness[self._mechanism.joints]
        joints = np.flatnonzero(np.abs(arms) > COUPLED)
        ways = arms / stiffness if (stiffness[joints] > 0).all() else arms
        rows = np.zeros((len(joints) - 1, len(arms)))
        for row, joint in zip(rows, joints[1:], strict=True):
            row[joint], row[joints[0]] = ways[joints[0]], -ways[joint]
            row /= np.abs(row).max()
        return rows

    def groups(self) -> Iterator[list[int]]:
        """Yield the groups of joints that are coupled, those with more than one."""
        joined = np.eye(len(self._mechanism.joints), dtype=bool)
        for row in np.abs(self._rows) > COUPLED:
            group = joined[row].any(axis=0)
            joined[group] = group
        for joint, group in enumerate(joined):
            if group.sum() > 1 and group.argmax() == joint:
                yield np.flatnonzero(group).tolist()

    def leaders(self, group: list[int]) -> list[int]:
        """Return the joints of a group that are moved, and do not follow from those before them."""
        led = self._mechanism.led_by_equality()
        order = sorted(group, key=lambda joint: (joint not in self._driven, joint in led, joint))
        moved = [joint for joint in order if joint in self.moved] or order[:1]
        # a tendon pulls joints as far as equalities let it: those decide where both leave no freedom
        return next(filter(None, (self._free(moved, fixed) for fixed in (self._fixed, self._equalities))), [])

    def _free(self, joints: list[int], fixed: Floats) -> list[int]:
        """Return those of some joints that do not follow, by rows (r, n), from those before them."""
        found: list[int] = []
        for joint in joints:
            unit = np.eye(len(self._mechanism.joints))[[joint]]
            with_joint = np.concatenate([fixed, unit])
            if _rank(with_joint) > _rank(fixed):
                found, fixed = [*found, joint], with_joint
        return found

    def sweep(self, leader: int, followers: list[int]) -> tuple[Floats, Floats]:
        """Return followers' places (s, f) at the leader's, and where equalities are met (s,)."""
        home, (low, high) = self._mechanism.home, self._mechanism.ranges[followers].T
        values = self._mechanism.positions(leader)
        start = int(np.abs(values - home[leader]).argmin())
        places, closed = np.zeros((POSITIONS, len(followers))), np.zeros(POSITIONS, dtype=bool)
        places[start] = home[followers]
        for way in (range(start, POSITIONS), range(start - 1, -1, -1)):
            place = places[start]
            for number in way:
                residuals = self._residuals(leader, followers, float(values[number]))
                place = _least_squares(residuals, place, low, high)
                open_by = np.abs(residuals(place)[: len(self._equality_scale)]).max(initial=0.0)
                places[number], closed[number] = place, open_by < OPEN_LOOP
        return places, closed

    def _residuals(self, leader: int, followers: list[int], value: float) -> Callable[[Floats], Floats]:
        """Return the function of followers' positions (f,) whose squares are to be least."""
        mechanism, model = self._mechanism, self._mechanism.model
        joints = [mechanism.joints[joint] for joint in followers]
        springs, tendon_springs = model.jnt_stiffness[joints], model.tendon_stiffness[self._sprung]
        strongest = max(springs.max(initial=0.0), tendon_springs.max(initial=0.0)) or 1.0
        rest = model.qpos_spring[model.jnt_qposadr[joints]]

        def residuals(place: Floats) -> Floats:
            positions = mechanism.home.copy()
            positions[leader], positions[followers] = value, place
            equalities, lengths = mechanism.measure(positions)
            tight = (lengths - model.tendon_range.mean(axis=1)) * self._tendon_scale
            strain = lengths - np.clip(lengths, *model.tendon_lengthspring.T)
            return np.concatenate(
                [
                    equalities * self._equality_scale,
                    TENDON_WEIGHT * tight[self._tight],
                    SHARE_WEIGHT * self._shares @ (positions - mechanism.home),
                    SPRING_WEIGHT * np.sqrt(springs / strongest) * (place - rest),
                    SPRING_WEIGHT * np.sqrt(tendon_springs / strongest) * strain[self._sprung],
                    REST_WEIGHT * (place - mechanism.home[followers]),
                ]
            )

        return residuals


def _least_squares(residuals: Callable[[Floats], Floats], guess: Floats, low: Floats, high: Floats) -> Floats:
    """Return the place (f,) between limits (f,) where the squares of residuals are least."""
    from scipy.optimize import least_squares

    exact: dict[str, Any] = {"jac": "3-point", "xtol": 1e-10, "ftol": 1e-12, "gtol": 1e-12}
    found: Floats = least_squares(residuals, guess, method="lm", **exact).x
    if ((found >= low - EXACT) & (found <= high + EXACT)).all():
        return np.clip(found, low, high)
    bounds = low, np.maximum(high, low + EXACT)  # limits have to differ
    return least_squares(residuals, np.clip(guess, low, high), bounds=bounds, **exact).x


def _scale(rows: Floats, owners: NDArray[Any]) -> Floats:
    """Return factors (r,) by which the greatest entry of each owner's rows (r, n) becomes 1."""
    greatest = np.abs(rows).max(axis=1, initial=0.0)
    return np.array([1 / max(greatest[owners == owner].max(), STEP) for owner in owners])


def _rank(rows: Floats) -> int:
    return int(np.linalg.matrix_rank(rows, tol=COUPLED)) if rows.size else 0
