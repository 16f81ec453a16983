// What the plugin calculates, without Gazebo and ROS: the servos' answer to commands, and the torque that makes an arm follow it.
//
// As construction_twin/physics/arm.py: each axis answers a held setpoint like a lag of second order, exactly discretised; torques are
// those of the inverse dynamics (recursive Newton-Euler), plus a stiff correction. SI; joints of one serial chain, first to last.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <cstdlib>
#include <istream>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

namespace construction_twin {

using Vector = std::array<double, 3>;
using Matrix = std::array<Vector, 3>;  // rows

inline Vector operator+(const Vector& a, const Vector& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
inline Vector operator-(const Vector& a, const Vector& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
inline Vector operator*(double s, const Vector& a) { return {s * a[0], s * a[1], s * a[2]}; }
inline double dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
inline Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
inline Vector operator*(const Matrix& m, const Vector& a) { return {dot(m[0], a), dot(m[1], a), dot(m[2], a)}; }
inline Vector transposed(const Matrix& m, const Vector& a) { return a[0] * m[0] + (a[1] * m[1] + a[2] * m[2]); }
inline Matrix operator*(const Matrix& a, const Matrix& b) {
  return {transposed(b, a[0]), transposed(b, a[1]), transposed(b, a[2])};
}

// Rotation about a unit axis (Rodrigues) [rad].
inline Matrix rotation(const Vector& axis, double angle) {
  const double c = std::cos(angle), s = std::sin(angle), d = 1.0 - c;
  const auto& [x, y, z] = axis;
  return {{{c + d * x * x, d * x * y - s * z, d * x * z + s * y},
           {d * x * y + s * z, c + d * y * y, d * y * z - s * x},
           {d * x * z - s * y, d * y * z + s * x, c + d * z * z}}};
}

// A joint and the body that it moves; the body's frame is the joint's.
struct Joint {
  std::string name;
  bool slides;
  Vector position;  // of the frame in the one before [m]
  Matrix orientation;
  Vector axis;
  double mass;  // [kg]
  Vector centre;  // of mass [m]
  Matrix inertia;  // about the centre of mass [kg m^2]
  double torque;  // most that the drive gives [N m], [N]; infinite: nobody says
  double armature, damping, friction;  // of motor and gear, seen from the axis
};

// Read a chain: gravity (3 numbers), then per joint its name and 29 numbers; physics/nodes/gazebo.py writes it.
struct Chain {
  Vector gravity;
  std::vector<Joint> joints;
};

inline double read_number(std::istream& text) {
  std::string word;
  text >> word;
  char* end = nullptr;
  const double number = std::strtod(word.c_str(), &end);  // an istream does not take "inf"
  if (word.empty() || *end != 0) throw std::invalid_argument("a number of the chain: found '" + word + "'");
  return number;
}

inline Vector read_vector(std::istream& text) {
  Vector vector;
  for (double& number : vector) number = read_number(text);
  return vector;
}

inline Chain read_chain(std::istream& text) {
  Chain chain{read_vector(text), {}};
  for (std::string name; text >> name;) {
    Joint joint;
    joint.name = name;
    joint.slides = read_number(text) != 0.0;
    joint.position = read_vector(text);
    for (Vector& row : joint.orientation) row = read_vector(text);
    joint.axis = read_vector(text);
    joint.mass = read_number(text);
    joint.centre = read_vector(text);
    const Vector moments = read_vector(text), products = read_vector(text);  // xx yy zz, xy xz yz
    joint.inertia = {{{moments[0], products[0], products[1]},
                      {products[0], moments[1], products[2]},
                      {products[1], products[2], moments[2]}}};
    joint.torque = read_number(text);
    joint.armature = read_number(text);
    joint.damping = read_number(text);
    joint.friction = read_number(text);
    chain.joints.push_back(joint);
  }
  if (chain.joints.empty()) throw std::invalid_argument("a chain without joints");
  return chain;
}

using Values = std::vector<double>;

// Forces of the joints [N m], [N] for positions, speeds and accelerations: what the bodies need, without motors and gears.
inline Values inverse_dynamics(const Chain& chain, const Values& q, const Values& speed, const Values& acceleration) {
  const size_t n = chain.joints.size();
  std::vector<Matrix> turned(n);  // from a body's frame to the one before
  std::vector<Vector> moved(n), force(n), moment(n);
  Vector omega{}, alpha{}, linear = -1.0 * chain.gravity;  // of the frame before, in it
  for (size_t i = 0; i < n; ++i) {
    const Joint& joint = chain.joints[i];
    turned[i] = joint.slides ? joint.orientation : joint.orientation * rotation(joint.axis, q[i]);
    moved[i] = joint.slides ? joint.position + q[i] * (joint.orientation * joint.axis) : joint.position;
    linear = transposed(turned[i], linear + (cross(alpha, moved[i]) + cross(omega, cross(omega, moved[i]))));
    omega = transposed(turned[i], omega);
    alpha = transposed(turned[i], alpha);
    if (joint.slides) {
      linear = linear + (acceleration[i] * joint.axis + 2.0 * cross(omega, speed[i] * joint.axis));
    } else {
      alpha = alpha + (acceleration[i] * joint.axis + cross(omega, speed[i] * joint.axis));
      omega = omega + speed[i] * joint.axis;
    }
    const Vector at_centre = linear + (cross(alpha, joint.centre) + cross(omega, cross(omega, joint.centre)));
    force[i] = joint.mass * at_centre;
    moment[i] = joint.inertia * alpha + (cross(omega, joint.inertia * omega) + cross(joint.centre, force[i]));
  }
  Values result(n);
  for (size_t i = n; i-- > 0;) {
    result[i] = dot(chain.joints[i].axis, chain.joints[i].slides ? force[i] : moment[i]);
    if (i > 0) {
      const Vector handed = turned[i] * force[i];
      force[i - 1] = force[i - 1] + handed;
      moment[i - 1] = moment[i - 1] + (turned[i] * moment[i] + cross(moved[i], handed));
    }
  }
  return result;
}

// exp(A * period) of (x - u, x') for x'' = -omega^2 (x - u) - 2 zeta omega x', u constant; as core/servo_lag.py.
inline std::array<std::array<double, 2>, 2> transition_matrix(double omega, double zeta, double period) {
  const double centre = -zeta * omega, scale = std::exp(centre * period);
  const std::complex<double> root = omega * std::sqrt(std::complex<double>(zeta * zeta - 1.0));
  const double even = std::cosh(root * period).real();
  const double odd = root == 0.0 ? period : (std::sinh(root * period) / root).real();
  return {{{scale * (even - centre * odd), scale * odd}, {-scale * omega * omega * odd, scale * (even + centre * odd)}}};
}

// An angle as the turn of it that is nearest to a reference: a physics engine may count to half a turn only.
inline double nearest(double angle, double reference) { return reference + std::remainder(angle - reference, 2.0 * M_PI); }

// The servos of an arm. The numbers are those of physics/arm.py.
class ArmControl {
 public:
  static constexpr double omega = 60.0, zeta = 0.8;  // of the lag [rad/s]
  static constexpr double stiffness = 150.0;  // of the correction [rad/s]
  static constexpr double creeping = 1e-3;  // below this speed friction grows with speed [rad/s], [m/s]
  // A command so far from the one before is none of a motion, but of an arm that is put elsewhere [rad], [m].
  static constexpr double jump = 0.1;

  ArmControl(Chain chain, double step)
      : chain_(std::move(chain)), step_(step), lag_(transition_matrix(omega, zeta, step)), effort_(size(), 0.0) {}

  const Chain& chain() const { return chain_; }
  size_t size() const { return chain_.joints.size(); }
  // Where the lag alone would have the arm [rad], [m].
  const Values& answer() const { return answer_; }
  // What the drives gave in the last step, motors and gears included [N m], [N].
  const Values& effort() const { return effort_; }

  // Take a command [rad], [m]; return whether the arm is to be put there at rest: it is the first one, or a jump.
  bool command(const Values& setpoint) {
    bool begins = setpoint_.empty();
    for (size_t i = 0; !begins && i < size(); ++i) begins = std::abs(setpoint[i] - setpoint_[i]) > jump;
    setpoint_ = setpoint;
    if (begins) {
      answer_ = setpoint;
      speed_.assign(size(), 0.0);
    }
    return begins;
  }

  // Advance one step from where the arm is; return what is to act on its joints [N m], [N].
  Values torques(const Values& q, const Values& speed) {
    Values wanted(size()), accelerations(size());
    for (size_t i = 0; i < size(); ++i) {
      const double at = chain_.joints[i].slides ? q[i] : nearest(q[i], answer_[i]);
      const double correction = stiffness * stiffness * (answer_[i] - at) + 2.0 * stiffness * (speed_[i] - speed[i]);
      const double error = answer_[i] - setpoint_[i], before = speed_[i];
      answer_[i] = setpoint_[i] + lag_[0][0] * error + lag_[0][1] * before;
      speed_[i] = lag_[1][0] * error + lag_[1][1] * before;
      wanted[i] = (speed_[i] - before) / step_;
      accelerations[i] = wanted[i] + correction;
    }
    Values result = inverse_dynamics(chain_, q, speed, accelerations);
    for (size_t i = 0; i < size(); ++i) {
      // what the drive spends on itself: the simulated bodies have neither motors nor gears
      const Joint& joint = chain_.joints[i];
      const double next = speed[i] + step_ * wanted[i];
      const double own = joint.armature * accelerations[i] + joint.damping * next +
                         joint.friction * std::clamp(next / creeping, -1.0, 1.0);
      effort_[i] = std::clamp(result[i] + own, -joint.torque, joint.torque);
      result[i] = effort_[i] - own;
    }
    return result;
  }

 private:
  Chain chain_;
  double step_;
  std::array<std::array<double, 2>, 2> lag_;
  Values setpoint_, answer_, speed_, effort_;
};

}  // namespace construction_twin
