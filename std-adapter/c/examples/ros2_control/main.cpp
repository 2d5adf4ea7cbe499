// Runs the hardware interface as a controller manager does: 125 Hz, an emergency stop, recovery. main ADDRESS
#include "denso_system.hpp"

#include <chrono>
#include <cstdlib>
#include <thread>

using hardware_interface::CallbackReturn;
using hardware_interface::return_type;

static void check(bool condition, const char *text) {
    if (!condition) {
        std::fprintf(stderr, "failed: %s\n", text);
        std::exit(1);
    }
}

// Moves the first joint by up to 2 degrees and back, for a number of cycles; returns the cycles until an error.
static int wave(DensoSystem &system, hardware_interface::CommandInterface &command, int cycles) {
    const double start = command.get_value();
    for (int cycle = 1; cycle <= cycles; cycle++) {
        command.set_value(start + 0.0175 * (1 - std::cos(cycle * 6.283185307179586 / 250)));
        if (system.read({}, {}) != return_type::OK || system.write({}, {}) != return_type::OK)
            return cycle;
    }
    return cycles;
}

int main(int argc, char **argv) {
    const rclcpp_lifecycle::State state;
    hardware_interface::HardwareInfo info;
    info.hardware_parameters = {{"address", argc > 1 ? argv[1] : "tcp:127.0.0.1"}, {"recover", "true"}};
    for (const char *name : {"joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"})
        info.joints.push_back({name});

    DensoSystem system;
    check(system.on_init(info) == CallbackReturn::SUCCESS, "on_init");
    auto states = system.export_state_interfaces();
    auto commands = system.export_command_interfaces();
    check(states.size() == 6 && states[0].get_name() == "joint_1/position", "the interfaces");

    // until the emergency stop is pressed, which ends a wave; an error is followed by on_error
    check(system.on_configure(state) == CallbackReturn::SUCCESS, "on_configure");
    check(system.on_activate(state) == CallbackReturn::SUCCESS, "on_activate");
    const int cycles = wave(system, commands[0], 100000);
    check(cycles < 100000 && cycles > 1, "the emergency stop ends the stream");
    check(system.on_error(state) == CallbackReturn::SUCCESS, "on_error");

    // until a person has released it, the activation fails, and the robot does not move
    int attempts = 1;
    for (;; attempts++) {
        check(attempts < 200, "the recovery");
        check(system.on_configure(state) == CallbackReturn::SUCCESS, "on_configure after the error");
        if (system.on_activate(state) == CallbackReturn::SUCCESS && wave(system, commands[0], 250) == 250)
            break;
        check(system.on_error(state) == CallbackReturn::SUCCESS, "on_error");
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
    check(attempts > 1, "an activation while the emergency stop is pressed fails");
    check(std::abs(states[0].get_value() - commands[0].get_value()) < 0.02, "the robot follows the commands");
    check(system.on_deactivate(state) == CallbackReturn::SUCCESS, "on_deactivate");
    check(system.on_cleanup(state) == CallbackReturn::SUCCESS, "on_cleanup");
    std::printf("stopped and recovered\n");
}
