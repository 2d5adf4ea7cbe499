// Reads and writes variables and moves, with objects and exceptions: cell tcp:192.168.0.1
#include <cstdio>
#include <iostream>

#include "bcap.hpp"

int main(int argc, char **argv) try {
    bcap::Controller cell(argc > 1 ? argv[1] : "tcp:127.0.0.1", BCAP_RC8);
    cell.write("S1", "a part");
    cell.write("P1", std::vector<float>{400, 0, 300, 180, 0, 180, 5});
    std::cout << cell.read<std::string>("S1") << " at " << cell.read<std::vector<double>>("P1")[0] << " mm\n";
    {
        bcap::Arm arm = cell.recover(true);
        arm.motor(true);
        arm.speed(100);
        arm.move(bcap::joint("J(0, 45, 90, 0, 45, 0)").speed(100), std::chrono::seconds(30));
        arm.start(bcap::joint("J(90, 45, 90, 0, 45, 0)").speed(5), std::chrono::minutes(1));
        throw std::runtime_error("the gripper lost the part"); // halts, switches the motor off, gives the arm back
    }
} catch (const bcap::Error &error) {
    std::cerr << "status " << error.status() << ": " << error.what() << '\n';
    return 1;
} catch (const std::exception &error) {
    std::cout << "stopped: " << error.what() << '\n';
}
