"""`learn gp`: a Gaussian process with output feedback, or one of delayed inputs where its options ask for that."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..block_file import LearnedBlock
from .feedback import learn_feedback_gp
from .single import learn_gaussian_process

OF_DELAYED_INPUTS = ("rate", "fit", "compress", "bound")  # options that only that process has
OF_FEEDBACK = ("evaluations", "starts", "select")


def learn_gp(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    feedback: bool | None = None,
    rate: bool | None = None,
    kernel: str | None = None,
    lags: int | tuple[int, int, int] | None = None,
    fit: str | None = None,
    points: int | None = None,
    samples: int | None = None,
    compress: int | str | None = None,
    bound: float | None = None,
    evaluations: int | None = None,
    starts: int | None = None,
    period: float | None = None,
    validate: Sequence[Record] = (),
    select: Sequence[Record] = (),
    seed: int = 0,
    name: str = "gaussian_process",
    progress: Callable | None = None,
) -> LearnedBlock:
    """Train a Gaussian process that runs freely: on its own outputs (`learn_feedback_gp`), unless told otherwise.

    feedback : False, the process of delayed inputs alone (`learn_gaussian_process`); None: that one where ``rate``,
    ``fit``, ``compress``, ``bound`` or one number of ``lags`` is given. Other options: as of the one that is trained;
    None takes its default.

    Raises: as the one that is trained, and `DeclarationError` for an option that it does not have.
    """
    given = {"rate": rate, "kernel": kernel, "lags": lags, "fit": fit, "points": points, "samples": samples}
    given |= {"compress": compress, "bound": bound, "evaluations": evaluations, "starts": starts}
    given |= {"period": period, "select": select or None}
    given = {option: value for option, value in given.items() if value is not None}
    only_delayed = [o for o in OF_DELAYED_INPUTS if o in given] + (["lags"] if isinstance(lags, int) else [])
    feedback = not only_delayed if feedback is None else feedback
    foreign = only_delayed if feedback else [o for o in OF_FEEDBACK if o in given]
    if foreign:
        raise DeclarationError(
            f"learn gp: {', '.join(foreign)} is no option of a process {'with' if feedback else 'without'} output "
            f"feedback (got feedback={feedback}). Leave it out, or say feedback={not feedback}."
        )
    train = learn_feedback_gp if feedback else learn_gaussian_process
    return train(records, inputs, outputs, validate=validate, seed=seed, name=name, progress=progress, **given)
