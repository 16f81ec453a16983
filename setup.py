from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import find_packages, setup

# catkin reads this file with the repository as its working folder
setup(**generate_distutils_setup(packages=find_packages("src"), package_dir={"": "src"}))
