// Answers questions about gazebo/arm_control.hpp, one line each, for test_gazebo_maths.py: a chain's file, then words on standard input.
#include <fstream>
#include <iomanip>
#include <iostream>
#include <sstream>

#include "../../gazebo/arm_control.hpp"

using namespace construction_twin;

static Values read_values(std::istream& line, size_t count) {
  Values values(count);
  for (double& value : values) value = read_number(line);
  return values;
}

static void tell(const Values& values) {
  for (double value : values) std::cout << value << ' ';
  std::cout << std::endl;
}

int main(int, char** words) try {
  std::ifstream file(words[1]);
  ArmControl control(read_chain(file), 0.001);
  const size_t n = control.size();
  std::cout << std::setprecision(17);
  for (std::string text; std::getline(std::cin, text);) {
    std::istringstream line(text);
    std::string asked;
    line >> asked;
    if (asked == "constants") {
      tell({ArmControl::omega, ArmControl::zeta, ArmControl::stiffness, ArmControl::creeping, ArmControl::jump});
    } else if (asked == "lag") {
      const Values v = read_values(line, 3);
      const auto m = transition_matrix(v[0], v[1], v[2]);
      tell({m[0][0], m[0][1], m[1][0], m[1][1]});
    } else if (asked == "nearest") {
      const Values v = read_values(line, 2);
      tell({nearest(v[0], v[1])});
    } else if (asked == "dynamics") {
      const Values q = read_values(line, n), speed = read_values(line, n), acceleration = read_values(line, n);
      tell(inverse_dynamics(control.chain(), q, speed, acceleration));
    } else if (asked == "command") {
      tell({control.command(read_values(line, n)) ? 1.0 : 0.0});
    } else if (asked == "torques") {
      const Values q = read_values(line, n), speed = read_values(line, n);
      tell(control.torques(q, speed));
    } else if (asked == "effort") {
      tell(control.effort());
    } else if (asked == "answer") {
      tell(control.answer());
    } else {
      throw std::invalid_argument("unknown question '" + asked + "'");
    }
  }
  return 0;
} catch (const std::exception& error) {
  std::cerr << error.what() << std::endl;
  return 1;
}
