"""7.4.2 on the ROS graph: Sinusoidal reference on the ROS graph."""

from __future__ import annotations

from vo2_studies.reproduce.claims import Context, Section
from vo2_studies.reproduce.graph_sections import integrated_section
from vo2_studies.reproduce.sections.chapter_7 import references

NUMBER, TITLE = "7.4.2", "Sinusoidal reference on the ROS graph"


def run(context: Context) -> Section:
    """Run the scenario; about 40 s."""
    return integrated_section(
        NUMBER, TITLE, references()["sine"], {"composite": 0.69, "polynomial": 2.79}, context
    )
