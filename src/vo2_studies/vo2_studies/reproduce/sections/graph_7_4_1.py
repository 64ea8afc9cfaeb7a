"""7.4.1 on the ROS graph: Step references on the ROS graph."""

from __future__ import annotations

from vo2_studies.reproduce.claims import Context, Section
from vo2_studies.reproduce.graph_sections import integrated_section
from vo2_studies.reproduce.sections.chapter_7 import references

NUMBER, TITLE = "7.4.1", "Step references on the ROS graph"


def run(context: Context) -> Section:
    """Run the scenario; about 20 s."""
    return integrated_section(
        NUMBER, TITLE, references()["steps"], {"composite": 1.11, "polynomial": 3.12}, context
    )
