import numpy as np
import yaml
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from qdgrasp_coordinator.exchange.decimals import decimals, shortest

FINITE = {"allow_nan": False, "allow_infinity": False}


@given(arrays.arrays(np.float32, (1, 3), elements=st.floats(width=32, **FINITE)))
def test_decimals_give_back_every_bit_of_float32(table: np.ndarray) -> None:
    read = np.array([yaml.safe_load(f"[{', '.join(line)}]") for line in decimals(table)])
    assert read.dtype == np.float64
    assert read.astype(np.float32).tobytes() == table.tobytes()


@given(arrays.arrays(np.float64, (1, 3), elements=st.floats(-1e6, 1e6)))
def test_decimals_give_back_every_bit_of_float64(table: np.ndarray) -> None:
    read = np.array([yaml.safe_load(f"[{', '.join(line)}]") for line in decimals(table)])
    assert read.tobytes() == table.tobytes()


def test_a_table_without_columns_has_empty_lines() -> None:
    assert decimals(np.zeros((2, 0))) == [[], []]


def test_decimals_are_as_short_as_can_be_with_a_point_and_without_an_exponent() -> None:
    numbers = [0.0, -0.0, 2.0, 1e-7, -1.5e-5, 1e16, 0.1, np.nan, -np.inf]
    expected = ["0.0", "-0.0", "2.0", "0.0000001", "-0.000015", "10000000000000000.0", "0.1", "nan", "-inf"]
    assert shortest(np.array(numbers)) == expected
    assert shortest(np.array([0.1, 1e-5, 3.0], np.float32)) == ["0.1", "0.00001", "3.0"]
