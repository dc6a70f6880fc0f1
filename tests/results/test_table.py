"""The table of results: a line a run."""

import random

import pytest
from tests.benchmarks.results import table
from tests.benchmarks.results.row import COLUMNS, Row, key
from tests.results.make_rows import BEFORE, TODAY, row

from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.spec import RunSpec

ROWS = [row(seed=seed, method=method) for method in ("aimed", "me_scs") for seed in (0, 1, 10)]


def written(*rows: Row) -> str:
    return table.text(table.merged({}, rows, {TODAY}))


class TestIdentity:
    def test_a_spec_and_the_row_of_its_run_have_one_key(self) -> None:
        spec = RunSpec(gripper="panda", object="ycb_mug", method="me_scs", evaluations=1000, overlaps="count")
        assert key(spec) == row("me_scs").key

    @pytest.mark.parametrize(
        "other",
        [{"seed": 1}, {"protocol": "released"}, {"evaluations": 999}, {"population": 60}, {"mass": 0.2}],
    )
    def test_whatever_a_spec_says_is_in_its_key(self, other: dict[str, object]) -> None:
        spec = {"gripper": "panda", "object": "ycb_mug"}
        assert key(RunSpec(**spec)) != key(RunSpec(**spec, **other))  # type: ignore[arg-type]

    def test_what_has_no_column_is_told_where_it_is_not_the_specs_default(self) -> None:
        assert key(RunSpec(gripper="panda", object="mug", population=50)).settings == "population=50"

    @pytest.mark.parametrize("file", ["/home/me/mine.stl", "mine.stl", "here/mine"])
    def test_a_run_on_a_file_has_no_row(self, file: str) -> None:
        with pytest.raises(InputError, match="is a file of this machine"):
            key(RunSpec(gripper="panda", object=file))


class TestText:
    def test_a_table_comes_back_as_it_was(self, tmp_path) -> None:
        whole = table.merged({}, [*ROWS, row(object="mug", coverage=0.12345, set_size=7060)], {TODAY})
        table.write(tmp_path / "runs.csv", whole)
        assert table.read(tmp_path / "runs.csv") == whole

    def test_no_file_is_an_empty_table(self, tmp_path) -> None:
        assert table.read(tmp_path / "runs.csv") == {}

    def test_the_order_in_which_rows_came_changes_nothing(self) -> None:
        shuffled = random.Random(0).sample(ROWS, len(ROWS))  # noqa: S311 - no secret
        assert written(*shuffled) == written(*ROWS)

    def test_seeds_are_in_the_order_of_numbers(self) -> None:
        lines = written(*ROWS).splitlines()[1:]
        assert [line.split(",")[COLUMNS.index("seed")] for line in lines] == ["0", "1", "10"] * 2

    def test_a_run_more_is_one_line_more(self) -> None:
        before, after = written(*ROWS[:-1]).splitlines(), written(*ROWS).splitlines()
        assert len(after) == len(before) + 1
        assert [line for line in after if line in before] == before

    def test_an_older_table_may_lack_a_figure(self, tmp_path) -> None:
        file, column = tmp_path / "runs.csv", COLUMNS.index("niches")
        lines = [line.split(",") for line in written(*ROWS).splitlines()]
        file.write_text("\n".join(",".join(line[:column] + line[column + 1 :]) for line in lines) + "\n")
        assert list(table.read(file).values()) == sorted(ROWS, key=lambda one: one.key)


class TestBadText:
    @pytest.mark.parametrize(
        ("old", "new", "said"),
        [
            ("gripper,", "gripers,", "line 1: unknown column 'gripers'"),
            ("gripper,", "", "line 1: column 'gripper' is missing"),
            (",1000,0.1.0", ",many,0.1.0", r"line 2: .*int.*budget"),
            (",0.1.0", "", "line 2: expected 35 fields"),
            ("aimed,count,,1", "aimed,count,,0", "line 3: aimed with panda on ycb_mug, seed 0"),
        ],
    )
    def test_it_is_refused_in_one_sentence_with_its_line(self, tmp_path, old, new, said) -> None:
        file = tmp_path / "runs.csv"
        file.write_text(written(*ROWS).replace(old, new, 1))
        with pytest.raises(InputError, match=said) as error:
            table.read(file)
        assert str(file) in str(error.value)
        assert "\n" not in str(error.value)

    def test_what_is_no_text_is_no_table(self, tmp_path) -> None:
        (tmp_path / "runs.csv").write_bytes(b"\xff\xfe")
        with pytest.raises(InputError, match="no table of results"):
            table.read(tmp_path / "runs.csv")


class TestMerging:
    def test_a_row_of_todays_code_takes_the_place_of_an_older_one(self) -> None:
        old, new = row(code=BEFORE, cells=1), row(cells=2)
        assert list(table.merged({old.key: old}, [new], {TODAY}).values()) == [new]

    def test_a_row_of_older_code_stays_until_then(self) -> None:
        old = row(code=BEFORE)
        assert old in table.merged({old.key: old}, ROWS[1:], {TODAY}).values()

    def test_an_older_row_takes_no_place_of_a_row_of_today(self) -> None:
        new = row()
        assert list(table.merged({new.key: new}, [row(code=BEFORE)], {TODAY}).values()) == [new]

    def test_a_run_done_again_takes_its_own_place(self) -> None:
        before, again = row(cells=1), row(cells=2)
        assert list(table.merged({before.key: before}, [again], {TODAY}).values()) == [again]
