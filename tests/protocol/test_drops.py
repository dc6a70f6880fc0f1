from structlog.testing import capture_logs

from qdgrasp_protocol.drops import Drops


def test_every_drop_is_counted_and_few_are_told() -> None:
    drops = Drops()
    with capture_logs() as said:
        for _ in range(10_000):
            drops.note("qdgrasp/v1/mugs/@result/" + "x" * 1000, "no such message")
    assert drops.count == 10_000
    assert [line["dropped"] for line in said] == [2**power for power in range(14)]
    assert all(len(line["key"]) <= 200 for line in said)
