"""How well twin and arm agreed: alignment, tables, figures and report of a recording.

In: joint states, feedback, plans, executions and link reports, of a bag or another recording. Out: error tables beside those of
the paper, timing, figures, ``summary.json``, ``report.html``, and ``replay.json``, which a browser plays. May import ``core``,
``servo``, ``robot`` and ``kinematics``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.evaluation.alignment import Alignment as Alignment
    from construction_twin.evaluation.alignment import TwinPath as TwinPath
    from construction_twin.evaluation.alignment import Window as Window
    from construction_twin.evaluation.alignment import align_by_command as align_by_command
    from construction_twin.evaluation.alignment import align_instant as align_instant
    from construction_twin.evaluation.alignment import align_lag_removed as align_lag_removed
    from construction_twin.evaluation.alignment import estimate_lag as estimate_lag
    from construction_twin.evaluation.alignment import task_window as task_window
    from construction_twin.evaluation.bag import Bag as Bag
    from construction_twin.evaluation.bag import recording_of as recording_of
    from construction_twin.evaluation.paper import PaperError as PaperError
    from construction_twin.evaluation.paper import paper_error as paper_error
    from construction_twin.evaluation.pure_bag import PureBag as PureBag
    from construction_twin.evaluation.pure_bag import open_bag as open_bag
    from construction_twin.evaluation.pure_bag import read_recording as read_recording
    from construction_twin.evaluation.recording import FeedbackStream as FeedbackStream
    from construction_twin.evaluation.recording import LinkSnapshot as LinkSnapshot
    from construction_twin.evaluation.recording import PlayedPlan as PlayedPlan
    from construction_twin.evaluation.recording import RecordedVerdict as RecordedVerdict
    from construction_twin.evaluation.recording import Recording as Recording
    from construction_twin.evaluation.recording import StateChange as StateChange
    from construction_twin.evaluation.recording import Stream as Stream
    from construction_twin.evaluation.replay import replay_of as replay_of
    from construction_twin.evaluation.report import Report as Report
    from construction_twin.evaluation.report import write_report as write_report
    from construction_twin.evaluation.summary import Evaluation as Evaluation
    from construction_twin.evaluation.summary import evaluate as evaluate
    from construction_twin.evaluation.summary import summarise as summarise
    from construction_twin.evaluation.tables import render_tables as render_tables
    from construction_twin.evaluation.tables import table_csv as table_csv
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
