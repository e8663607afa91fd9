"""What is to be asked for a task, by where it stands."""

from __future__ import annotations

from ua_fleet.scenario.effects import AskOperator, CancelTask, DecisionNeeded, FollowTask, StartTask, WantRobot
from ua_fleet.scenario.model import Task
from ua_fleet.scenario.state import TaskPhase, TaskRun

__all__ = ["asked_for", "cancel", "follow", "question_about"]


def asked_for(
    step: str, task: Task, task_run: TaskRun, robot: str | None
) -> WantRobot | StartTask | FollowTask | DecisionNeeded | AskOperator | None:
    """What a task waits for, to be asked for now or once more; None where it is over.

    Args:
        step: its key, with the repetition.
        task: as it is written.
        task_run: where it stands.
        robot: that it is for, while it waits for one; None: any.
    """
    match task_run.phase:
        case TaskPhase.WANTED:
            return WantRobot(step, task.name, task.skill, robot, task.capacities)
        case TaskPhase.ASSIGNED | TaskPhase.ACCEPTED:
            return StartTask(
                step,
                task.name,
                task_run.execution_id,
                task_run.robot,
                task_run.skill,
                task_run.arguments,
                task.timeout_s,
            )
        case TaskPhase.REPLACING:
            return DecisionNeeded(step, task.name, task.skill, task.capacities, task_run.robot, task_run.reason)
        case TaskPhase.HALTING | TaskPhase.LOST:
            return follow(step, task_run)
        case TaskPhase.ASKED:
            return AskOperator(
                step,
                task.name,
                task_run.robot,
                question_about(task_run),
                task_run.skill,
                task_run.execution_id,
                task.capacities,
            )
        case TaskPhase.OVER:
            return None


def question_about(task_run: TaskRun) -> str:
    """What people are asked of a task that nobody knows the end of."""
    done = f"was {task_run.name} ({task_run.skill} on {task_run.robot}) done? {task_run.reason}"
    return f"{done}; {task_run.robot} may still be at it, and a second robot would do it beside it, or twice"


def cancel(task_run: TaskRun) -> CancelTask:
    """Have the robot of an attempt stop, or not begin."""
    return CancelTask(task_run.execution_id, task_run.robot, task_run.skill)


def follow(step: str, task_run: TaskRun) -> FollowTask:
    """Listen for what became of an attempt, and begin nothing."""
    may_be_unasked = task_run.phase is TaskPhase.ASSIGNED
    return FollowTask(step, task_run.execution_id, task_run.executed_by, task_run.skill, may_be_unasked)
