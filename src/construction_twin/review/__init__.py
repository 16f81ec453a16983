"""A person decides: the queue of plans and verdicts, and the record of every verdict.

In: plans, and verdicts that name a plan by id and hash. Out: approvals, each for one execution of one trajectory, and an
append-only file that is written before anything moves. May import ``core`` and ``robot``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.review.chained_file import ChainedFile as ChainedFile
    from construction_twin.review.chained_file import verify as verify
    from construction_twin.review.plan_under_review import Ending as Ending
    from construction_twin.review.plan_under_review import PlanUnderReview as PlanUnderReview
    from construction_twin.review.plan_under_review import Verdict as Verdict
    from construction_twin.review.plan_under_review import prove_hash as prove_hash
    from construction_twin.review.record import Record as Record
    from construction_twin.review.record import Release as Release
    from construction_twin.review.record import Responsibility as Responsibility
    from construction_twin.review.record import ReviewLog as ReviewLog
    from construction_twin.review.record import read_fate as read_fate
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
