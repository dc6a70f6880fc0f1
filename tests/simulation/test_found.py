"""What histories have found, each in its smallest form."""

from tests.coordinator.dispatching.leases import ANN, EPOCH, settle, with_work

from qdgrasp_coordinator.dispatching.batch import Settlement
from qdgrasp_coordinator.dispatching.dispatch import Dispatch
from qdgrasp_protocol.messages import Joined
from qdgrasp_worker.serving.appointment import RETRY_FIRST, Appointment


def leased(dispatch: Dispatch) -> bytes:
    return dispatch.leases(0.0)[0].batch.id


def test_a_result_for_another_coordinator_of_the_same_epoch_settles_nothing() -> None:
    """Epochs come again where a disk is restored while its coordinator is stopped."""
    one, other = with_work(), with_work()
    lease = one.leases(0.0)[0]
    other.leases(0.0)
    assert settle(other, lease, 1.0, epoch=EPOCH).kind is Settlement.UNKNOWN
    assert leased(with_work()) != leased(with_work())


def test_a_worker_whose_token_comes_seconds_after_its_question_is_not_forgotten() -> None:
    dispatch = with_work()
    dispatch.expect(ANN, 0.0)
    assert dispatch.tick(5.0) == []
    assert dispatch.leases(5.0) == []
    dispatch.back(ANN, 5.0)
    assert len(dispatch.leases(5.0)) == 2


def test_a_worker_whose_token_never_comes_is_forgotten() -> None:
    dispatch = with_work()
    dispatch.expect(ANN, 0.0)
    assert [lost.wid for lost in dispatch.tick(60.0)] == [ANN]


def test_a_worker_joins_the_coordinator_that_is_left_when_the_one_that_answered_is_gone() -> None:
    appointment = Appointment("job")
    appointment.meet(1, True, 0.0)
    appointment.meet(2, True, 1.0)
    appointment.ask(2)
    appointment.answered(Joined(epoch=1, drop=[]), 1.5, 1.0)
    assert not appointment.is_due(2.0)
    appointment.meet(1, False, 2.0)
    assert appointment.is_due(2.0)


def test_a_worker_whose_question_an_older_coordinator_answers_asks_again() -> None:
    """The one that it serves knows of the join before only; what it leases would be passed over for ever."""
    appointment = Appointment("job")
    appointment.meet(8, True, 0.0)
    appointment.ask(2)
    appointment.answered(Joined(epoch=8, drop=[]), 1.0, 1.0)
    appointment.join_soon(2.0)
    appointment.ask(2)
    assert not appointment.answered(Joined(epoch=7, drop=[]), 3.0, 1.0)
    assert appointment.join_at == 3.0 + RETRY_FIRST
