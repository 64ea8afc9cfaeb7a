from glob import glob
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "vo2_estimation"
PACKAGE = ElementTree.parse("package.xml").getroot()
MAINTAINER = PACKAGE.find("maintainer")

setup(
    name=NAME,
    version=PACKAGE.findtext("version"),
    packages=find_packages(exclude=["test"]),
    package_data={NAME: ["py.typed", "**/*.yaml", "**/*.css", "**/*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml", "CHANGELOG.rst", "LICENSE"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
        (f"share/{NAME}/config", glob("config/*.yaml")),
    ],
    install_requires=["setuptools"],
    zip_safe=False,
    maintainer=MAINTAINER.text,
    maintainer_email=MAINTAINER.get("email"),
    description=PACKAGE.findtext("description"),
    license=PACKAGE.findtext("license"),
    # newer setuptools drops tests_require, and colcon would then silently run no test
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "estimator = vo2_estimation.executables:estimator",
        ],
    },
)
