// A hardware interface of ros2_control for a DENSO robot: joint positions in radians, read and written at 125 Hz in Slave Mode.
//
//   unconfigured ─ on_configure ─► inactive ─ on_activate ─► active: read, write, read, write, ...
//        ▲                                                     │ an emergency stop, an error, a late program
//        └────────────── on_error: the arm is given back ◄─────┘ write returns ERROR
//
// After an error the controller manager configures and activates again. Only with the parameter `recover` set to `true` does
// on_activate clear errors: a person must have looked at the robot. `write` blocks until the next cycle, so it paces the loop.
#ifndef DENSO_SYSTEM_HPP
#define DENSO_SYSTEM_HPP

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <memory>
#include <optional>

#include "bcap.hpp"
#include "hardware_interface.hpp"

class DensoSystem : public hardware_interface::SystemInterface {
    using CallbackReturn = hardware_interface::CallbackReturn;
    using return_type = hardware_interface::return_type;
    static constexpr double DEGREE = 3.14159265358979323846 / 180;

public:
    CallbackReturn on_init(const hardware_interface::HardwareInfo &info) override {
        if (info.joints.empty() || info.joints.size() > positions_.size())
            return CallbackReturn::ERROR;
        return SystemInterface::on_init(info);
    }

    CallbackReturn on_configure(const rclcpp_lifecycle::State &) override {
        return attempt([this] {
            cell_.emplace(info_.hardware_parameters.at("address"), BCAP_RC8);
            set_positions(cell_->joints());
        });
    }

    CallbackReturn on_cleanup(const rclcpp_lifecycle::State &) override {
        end();
        return CallbackReturn::SUCCESS;
    }

    CallbackReturn on_activate(const rclcpp_lifecycle::State &) override {
        return attempt([this] {
            const auto recover = info_.hardware_parameters.find("recover");
            if (recover != info_.hardware_parameters.end() && recover->second == "true")
                arm_.emplace(cell_->recover(true));
            else
                arm_.emplace(cell_->take_arm());
            arm_->motor(true);
            stream_.emplace(arm_->stream({100, 800, 100, 2}));
            set_positions(stream_->joints());
            // the first command is where the robot is
            commands_ = positions_;
        });
    }

    CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) override {
        return attempt([this] {
            if (stream_)
                stream_->finish();
            stream_.reset();
            arm_->give();
            arm_.reset();
        });
    }

    CallbackReturn on_error(const rclcpp_lifecycle::State &) override {
        end();
        return CallbackReturn::SUCCESS;
    }

    std::vector<hardware_interface::StateInterface> export_state_interfaces() override { return handles(positions_); }
    std::vector<hardware_interface::CommandInterface> export_command_interfaces() override { return handles(commands_); }

    return_type read(const rclcpp::Time &, const rclcpp::Duration &) override {
        if (stream_)
            set_positions(stream_->joints());
        return return_type::OK;
    }

    return_type write(const rclcpp::Time &, const rclcpp::Duration &) override {
        if (!stream_)
            return return_type::ERROR;
        bcap::Joints degrees{};
        std::transform(commands_.begin(), commands_.end(), degrees.begin(), [](double command) { return command / DEGREE; });
        const bool sent = attempt([&] { stream_->step(degrees); }) == CallbackReturn::SUCCESS;
        return sent ? return_type::OK : return_type::ERROR;
    }

    /// The status of the last failure.
    bcap_status status() const { return status_; }

private:
    template <class Calls> CallbackReturn attempt(Calls calls) {
        try {
            calls();
            return CallbackReturn::SUCCESS;
        } catch (const bcap::Error &error) {
            status_ = error.status();
            std::fprintf(stderr, "denso: %s\n", error.what());
            return CallbackReturn::ERROR;
        }
    }

    void end() {
        // in this order: the stream, the arm, the session
        stream_.reset();
        arm_.reset();
        cell_.reset();
    }

    void set_positions(const bcap::Joints &degrees) {
        std::transform(degrees.begin(), degrees.end(), positions_.begin(), [](double degree) { return degree * DEGREE; });
    }

    std::vector<hardware_interface::Handle> handles(bcap::Joints &values) {
        std::vector<hardware_interface::Handle> handles;
        for (std::size_t joint = 0; joint < info_.joints.size(); joint++)
            handles.emplace_back(info_.joints[joint].name, hardware_interface::HW_IF_POSITION, &values[joint]);
        return handles;
    }

    std::optional<bcap::Controller> cell_;
    std::optional<bcap::Arm> arm_;
    std::optional<bcap::Stream> stream_;
    bcap::Joints positions_{}, commands_{};
    bcap_status status_ = BCAP_OK;
};

#endif
