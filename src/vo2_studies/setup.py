from glob import glob

from setuptools import find_packages, setup

NAME = "vo2_studies"

setup(
    name=NAME,
    version="0.2.0",
    packages=find_packages(exclude=["test"]),
    package_data={NAME: ["py.typed", "**/*.yaml", "**/*.css", "**/*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
        (f"share/{NAME}/config", glob("config/*.yaml")),
    ],
    install_requires=["setuptools"],
    zip_safe=False,
    maintainer="VO2 actuator maintainers",
    maintainer_email="maintainers@example.org",
    description="Challenge, reproduction, measured studies, demo and benches: what proves the libraries.",
    license="MIT",
    # newer setuptools drops tests_require, and colcon would then silently run no test
    extras_require={"test": ["pytest"]},
)
