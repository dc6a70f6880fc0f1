import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.keys import NAME, Keys, job_of, matches, parse_number

WID = "0123456789abcdef" * 2


def built(keys: Keys) -> list[str]:
    """Every concrete key of a job."""
    return [
        keys.work(WID),
        keys.result(WID),
        keys.ctl(WID),
        keys.join,
        keys.control,
        keys.asset("a" * 64),
        keys.outcome(3),
        keys.recorded,
        keys.open,
        keys.log,
        keys.coordinator_token(3),
        keys.worker_token(WID),
        keys.recorder_token("r"),
        keys.stat("run/run"),
        keys.meta,
    ]


@given(st.from_regex(NAME, fullmatch=True))
def test_every_key_says_which_job_it_belongs_to(job: str) -> None:
    keys = built(Keys(job))
    assert {job_of(key) for key in keys} == {job}
    assert len(set(keys)) == len(keys)


@pytest.mark.parametrize("job", ["", "Mugs", "a/b", "*", "@a", "a" * 65, "mugs\n"])
def test_a_name_of_other_characters_is_refused(job: str) -> None:
    with pytest.raises(ImpossibleValue, match="job must be 1 to 64 of the characters"):
        Keys(job)


@pytest.mark.parametrize(
    "key", ["", "qdgrasp/v1", "qdgrasp/v1/mugs", "qdgrasp/v2/mugs/x", "a/v1/mugs/x", "qdgrasp/v1/*/x"]
)
def test_a_key_that_is_not_ours_belongs_to_no_job(key: str) -> None:
    assert job_of(key) is None


def test_a_subscriber_to_everything_hears_none_of_the_bulk() -> None:
    heard = [key for key in built(Keys("mugs")) if matches("qdgrasp/**", key)]
    assert heard == [key for key in built(Keys("mugs")) if "/@" not in key]
    assert len(heard) == 9


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *(("0", 0), ("17", 17), ("9" * 18, 10**18 - 1)),
        *((text, None) for text in ("", "-1", "x", "²", "9" * 5000)),
    ],
)
def test_a_number_in_a_key_is_plain_digits_and_not_without_end(text: str, value: int | None) -> None:
    assert parse_number(text) == value


CHUNKS = st.sampled_from(["a", "b", "@a", "@b"])
PATTERNS = st.lists(CHUNKS | st.sampled_from(["*", "**"]), min_size=1, max_size=6).map("/".join)


@given(PATTERNS, PATTERNS)
def test_patterns_meet_as_in_zenoh(one: str, other: str) -> None:
    keys = [zenoh.KeyExpr.autocanonize(pattern) for pattern in (one, other)]
    assert matches(one, other) == keys[0].intersects(keys[1])
