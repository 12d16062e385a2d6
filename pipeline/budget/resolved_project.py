"""The project with what its budgets choose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.budget.capture_size import UNKNOWN, capture_size
from pipeline.budget.estimate import Estimate
from pipeline.config.loading import Project
from pipeline.config.project import SubjectSettings


@dataclass(frozen=True)
class ResolvedProject(Project):
    """Project whose subjects with `budget_minutes` have settings that fit.

    They are chosen once they are asked for.

    Attributes:
        say: told, line by line, what was chosen and what to expect of it.
        known: what was chosen so far, by subject.
    """

    say: Callable[[str], object]
    known: dict[str, tuple[SubjectSettings, Estimate]] = field(default_factory=dict)

    def subject(self, name: str) -> SubjectSettings:
        """The settings of any subject, with what its budget chooses.

        Raises:
            InputError: if nothing fits, or the curves cannot be read.
        """
        settings = super().subject(name)
        return settings if settings.budget_minutes is None else self._chosen(name, settings)[0]

    def estimate(self, name: str) -> Estimate | None:
        """Estimate of a subject's budget; None without a budget."""
        settings = super().subject(name)
        return None if settings.budget_minutes is None else self._chosen(name, settings)[1]

    def _chosen(self, name: str, settings: SubjectSettings) -> tuple[SubjectSettings, Estimate]:
        if name not in self.known:
            # Numerical libraries, for which no plan without a budget should have to wait.
            from pipeline.budget.allocation import within_budget
            from pipeline.budget.curves import FOLDER, read_curves, read_measured

            curves, measured = read_curves(FOLDER / "accuracy_cost.csv"), read_measured(FOLDER / "subjects.yaml")
            size = capture_size(settings, Path(self.settings.captures) / name, UNKNOWN)
            self.known[name] = within_budget(
                name, settings, self.said_by_user(name), size, curves, measured, self.settings.machine_pace
            )
            for line in self.known[name][1].lines():
                self.say(line)
        return self.known[name]


def resolve_budgets(project: Project, say: Callable[[str], object]) -> ResolvedProject:
    """The same project; a budget chooses when a subject's settings are asked for, and says so."""
    return ResolvedProject(project.settings, project.subjects, project.written, project.command_line, say)
