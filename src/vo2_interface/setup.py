from glob import glob
from xml.etree import ElementTree

from setuptools import find_packages, setup

try:  # without it, as where this package is looked at before vo2_interface is built, the scripts are ordinary ones
    from vo2_interface.console_scripts import holding
except ModuleNotFoundError:

    def holding(*entries):
        return {}


NAME = "vo2_interface"
PACKAGE = ElementTree.parse("package.xml").getroot()
MAINTAINER = PACKAGE.find("maintainer")
NODES = [
    "live = vo2_interface.executables:live",
    "beam = vo2_interface.executables:beam",
    "supervise = vo2_interface.executables:supervise",
]

setup(
    name=NAME,
    version=PACKAGE.findtext("version"),
    packages=find_packages(exclude=["test"]),
    package_data={NAME: ["py.typed", "**/*.yaml", "**/*.html", "**/*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml", "CHANGELOG.rst", "LICENSE"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
        (f"share/{NAME}/config", glob("config/*.yaml")),
        (f"share/{NAME}/layouts", glob("layouts/*")),
        (f"share/{NAME}/urdf", glob("urdf/*.urdf")),
        (f"share/{NAME}/security", glob("security/*")),
    ],
    install_requires=["setuptools"],
    zip_safe=False,
    maintainer=MAINTAINER.text,
    maintainer_email=MAINTAINER.get("email"),
    description=PACKAGE.findtext("description"),
    license=PACKAGE.findtext("license"),
    # newer setuptools drops tests_require, and colcon would then silently run no test
    extras_require={"test": ["pytest"]},
    cmdclass=holding(*NODES),
    entry_points={
        "console_scripts": [
            *NODES,
        ]
    },
)
