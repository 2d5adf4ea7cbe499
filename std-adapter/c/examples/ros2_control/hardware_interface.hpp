// The part of ros2_control (hardware_interface, Humble to Jazzy) that the example needs, so that it compiles without ROS. With ROS,
// include "hardware_interface/system_interface.hpp" and "rclcpp_lifecycle/state.hpp" instead.
#ifndef HARDWARE_INTERFACE_STUB_HPP
#define HARDWARE_INTERFACE_STUB_HPP

#include <cstdint>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

namespace rclcpp {
struct Time {
    std::int64_t nanoseconds;
};
struct Duration {
    std::int64_t nanoseconds;
};
} // namespace rclcpp

namespace rclcpp_lifecycle {
struct State {};
} // namespace rclcpp_lifecycle

namespace hardware_interface {

inline constexpr char HW_IF_POSITION[] = "position";

enum class return_type : std::uint8_t { OK = 0, ERROR = 1 };
enum class CallbackReturn : std::uint8_t { SUCCESS, FAILURE, ERROR };

struct ComponentInfo {
    std::string name;
};

struct HardwareInfo {
    std::unordered_map<std::string, std::string> hardware_parameters;
    std::vector<ComponentInfo> joints;
};

class Handle {
public:
    Handle(std::string joint, std::string interface, double *value)
        : name_(std::move(joint) + "/" + interface), value_(value) {}
    const std::string &get_name() const { return name_; }
    double get_value() const { return *value_; }
    void set_value(double value) { *value_ = value; }

private:
    std::string name_;
    double *value_;
};
using StateInterface = Handle;
using CommandInterface = Handle;

class SystemInterface {
public:
    virtual ~SystemInterface() = default;
    virtual CallbackReturn on_init(const HardwareInfo &info) {
        info_ = info;
        return CallbackReturn::SUCCESS;
    }
    virtual CallbackReturn on_configure(const rclcpp_lifecycle::State &) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_cleanup(const rclcpp_lifecycle::State &) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_error(const rclcpp_lifecycle::State &) { return CallbackReturn::ERROR; }
    virtual std::vector<StateInterface> export_state_interfaces() = 0;
    virtual std::vector<CommandInterface> export_command_interfaces() = 0;
    virtual return_type read(const rclcpp::Time &, const rclcpp::Duration &) = 0;
    virtual return_type write(const rclcpp::Time &, const rclcpp::Duration &) = 0;

protected:
    HardwareInfo info_;
};

} // namespace hardware_interface

#endif
