from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import setup

setup(
    **generate_distutils_setup(
        packages=[
            "construction_twin",
            "construction_twin.cli",
            "construction_twin.evaluation",
            "construction_twin.kinematics",
            "construction_twin.model",
            "construction_twin.mqtt",
            "construction_twin.planning",
            "construction_twin.ros",
            "construction_twin.rsi",
            "construction_twin.scenario",
            "construction_twin.scene",
        ],
        package_dir={"": "src"},
    )
)
