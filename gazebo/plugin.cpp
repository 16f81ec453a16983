// The twin in Gazebo 11: a model plugin that moves an arm as it is commanded, one cycle of the world per command.
//
// In: `twin/commanded`. Out, with the command's stamp: `gazebo/joint_states` (the pose at the end of its cycle), and 50 times a second
// `twin/effort`. The world waits for the next command, so that its time is the commands'; without any it goes on slowly.
#include <pthread.h>
#include <ros/ros.h>
#include <sensor_msgs/JointState.h>

#include <chrono>
#include <condition_variable>
#include <deque>
#include <gazebo/common/Plugin.hh>
#include <gazebo/physics/physics.hh>
#include <mutex>
#include <sstream>
#include <thread>

#include "arm_control.hpp"

namespace construction_twin {

constexpr size_t MOST_WAITING = 25;  // commands; of more the oldest are dropped: the world is slower than the arm
constexpr int EFFORT_EVERY = 5;  // commands
constexpr std::chrono::milliseconds PATIENCE{250};  // as long as virtual_robot waits before it repeats a held pose

class TwinPlugin : public gazebo::ModelPlugin {
 public:
  ~TwinPlugin() override {
    update_.reset();
    if (spinner_) spinner_->stop();
    subscriber_.shutdown();
  }

  void Load(gazebo::physics::ModelPtr model, sdf::ElementPtr given) override {
    model_ = model;
    const double step = model->GetWorld()->Physics()->GetMaxStepSize();
    std::istringstream text(given->Get<std::string>("chain"));
    control_ = std::make_unique<ArmControl>(read_chain(text), step);
    steps_ = std::lround(0.004 / step);
    priority_ = given->Get<int>("realtime", 0).first;
    for (const Joint& joint : control_->chain().joints) {
      joints_.push_back(model->GetJoint(joint.name));
      if (!joints_.back()) throw std::runtime_error("the world has no joint " + joint.name);
      pose_.name.push_back(joint.name);
    }
    control_->command(Values(joints_.size(), 0.0));  // it holds the pose in which the world has it
    // the namespace is that of the process; its signals belong to Gazebo
    if (!ros::isInitialized()) ros::init(ros::M_string{}, "gazebo_arm", ros::init_options::NoSigintHandler);
    node_ = std::make_unique<ros::NodeHandle>();
    poses_ = node_->advertise<sensor_msgs::JointState>("gazebo/joint_states", 250);
    efforts_ = node_->advertise<sensor_msgs::JointState>("twin/effort", 5);
    subscriber_ = node_->subscribe("twin/commanded", 250, &TwinPlugin::OnCommand, this, ros::TransportHints().tcpNoDelay());
    spinner_ = std::make_unique<ros::AsyncSpinner>(1);
    spinner_->start();
    update_ = gazebo::event::Events::ConnectWorldUpdateBegin([this](const auto&) { OnStep(); });
  }

 private:
  void OnCommand(const sensor_msgs::JointStateConstPtr& command) {
    if (command->name != pose_.name || command->position.size() != joints_.size() ||
        !std::all_of(command->position.begin(), command->position.end(), [](double q) { return std::isfinite(q); })) {
      ROS_ERROR_THROTTLE(1.0, "a command of other joints than the world's, or not finite: refused");
      return;
    }
    std::lock_guard<std::mutex> lock(mutex_);
    waiting_.push_back(command);
    if (waiting_.size() > MOST_WAITING) waiting_.pop_front();
    news_.notify_one();
  }

  // Before each step of the world.
  void OnStep() {
    if (step_ == 0) Begin();
    Values q, speed;
    for (const auto& joint : joints_) {
      q.push_back(joint->Position(0));
      speed.push_back(joint->GetVelocity(0));
    }
    if (step_ == steps_) {  // where the last step of the cycle has led
      Tell(q);
      step_ = 0;
      return OnStep();
    }
    ++step_;
    const Values torques = control_->torques(q, speed);
    for (size_t i = 0; i < joints_.size(); ++i) joints_[i]->SetForce(0, torques[i]);
  }

  // Wait for a command and begin its cycle; without one the arm holds, and the world's time goes on for what else runs in it.
  void Begin() {
    if (priority_ > 0) {
      const sched_param parameter{priority_};
      if (pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameter) != 0) ROS_WARN("no real-time priority for Gazebo");
      priority_ = 0;
    }
    std::unique_lock<std::mutex> lock(mutex_);
    stamp_ = ros::Time();
    if (!news_.wait_for(lock, PATIENCE, [this] { return !waiting_.empty(); })) return;
    const auto command = waiting_.front();
    waiting_.pop_front();
    lock.unlock();
    stamp_ = command->header.stamp;
    if (control_->command(command->position)) {
      for (size_t i = 0; i < joints_.size(); ++i) joints_[i]->SetPosition(0, command->position[i]);
      model_->ResetPhysicsStates();
    }
  }

  void Tell(const Values& q) {
    if (stamp_.isZero()) return;
    pose_.header.stamp = stamp_;
    pose_.position = q;
    for (size_t i = 0; i < q.size(); ++i) {
      if (!control_->chain().joints[i].slides) pose_.position[i] = nearest(q[i], control_->answer()[i]);
    }
    poses_.publish(pose_);
    if (++told_ % EFFORT_EVERY == 0) {
      sensor_msgs::JointState effort = pose_;
      effort.effort = control_->effort();
      efforts_.publish(effort);
    }
  }

  gazebo::physics::ModelPtr model_;
  std::vector<gazebo::physics::JointPtr> joints_;
  std::unique_ptr<ArmControl> control_;
  gazebo::event::ConnectionPtr update_;
  std::unique_ptr<ros::NodeHandle> node_;
  std::unique_ptr<ros::AsyncSpinner> spinner_;
  ros::Publisher poses_, efforts_;
  ros::Subscriber subscriber_;
  sensor_msgs::JointState pose_;
  std::mutex mutex_;  // of what follows
  std::condition_variable news_;
  std::deque<sensor_msgs::JointStateConstPtr> waiting_;
  // of the world's thread alone
  ros::Time stamp_;
  long steps_ = 4, step_ = 0;
  int priority_ = 0, told_ = 0;
};

GZ_REGISTER_MODEL_PLUGIN(TwinPlugin)

}  // namespace construction_twin
