"""8.4.1 on the ROS graph: Step references on the ROS graph."""

from __future__ import annotations

from vo2_studies.reproduce.claims import Context, Section
from vo2_studies.reproduce.graph_sections import peltier_section
from vo2_studies.reproduce.sections.chapter_8_4 import published

NUMBER, TITLE = "8.4.1", "Step references on the ROS graph"


def run(context: Context) -> Section:
    """Run the scenario; about 15 s."""
    return peltier_section(NUMBER, TITLE, "steps", published("steps"), context)
