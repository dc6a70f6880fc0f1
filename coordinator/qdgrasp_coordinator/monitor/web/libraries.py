"""The library: where the page takes scenes and finds of runs from, over the bus or from a folder."""

from typing import Protocol


class Library(Protocol):
    """Scenes and finds of runs, as the page's view in 3D reads them.

    Its methods may take a while, and are called in threads.
    """

    def runs(self, job: str) -> bytes:
        """JSON: the runs of a job, finished ones too (`RunEntries`).

        Raises
        ------
        QdgraspError
            There is no such job, or nobody answers.
        """

    def curve(self, job: str, run: str) -> bytes:
        """JSON: how a run grew, also one that is over (`Curve`).

        Raises
        ------
        QdgraspError
            There is no such run, or nobody answers.
        """

    def scene(self, job: str, run: str) -> bytes:
        """JSON: the object, the hand's links and the bounds of a run.

        Raises
        ------
        QdgraspError
            There is no such run, or nobody answers.
        """

    def cells(self, job: str, run: str, since: int) -> bytes:
        """The voxels of a run with the serial `since` or a later one, packed as `voxels` says.

        Raises
        ------
        QdgraspError
            There is no such run, or nobody answers.
        """

    def grasp(self, job: str, run: str, number: int) -> bytes:
        """JSON: all that is known of the find with this journal number.

        Raises
        ------
        QdgraspError
            There is no such run or find, or nobody answers.
        """
