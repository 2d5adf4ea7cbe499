// Tests of the objects for C++ against the virtual controller: objects ADDRESS
#include <cstdio>

#include "bcap.hpp"
#include "check.h"

static const bcap::Motion home = bcap::joint("J(0, 45, 90, 0, 45, 0)").speed(100);
static const bcap::Motion aside = bcap::joint("J(10, 45, 90, 0, 45, 0)").speed(100);
static const auto limit = std::chrono::seconds(30);

// A new arm of the same controller stays taken when it replaces an old one.
static void arms(bcap::Controller &cell) {
    // clears the errors of earlier programs
    cell.recover(true).give();
    bcap::Arm arm = cell.take_arm();
    arm = cell.recover(true);
    arm.motor(true);
    arm.speed(100);
    arm.move(home, limit);
    // compilers warn of `arm = std::move(arm)`
    bcap::Arm &same = arm;
    arm = std::move(same);
    arm.move(aside, limit);
    {
        bcap::Arm other = std::move(arm);
        arm = std::move(other);
    }
    arm.move(home, limit);
    // after an assignment the end of the arm gives it back: otherwise it could not be taken again
    arm = cell.recover(true);
    {
        bcap::Arm other = std::move(arm);
    }
    arm = cell.take_arm();
}

// Steps a stream once; returns false if it has failed.
static bool steps(bcap::Stream &stream, const bcap::Joints &joints) {
    try {
        stream.step(joints);
        return true;
    } catch (const bcap::Error &error) {
        CHECK(error.status() == BCAP_E_STREAM);
        return false;
    }
}

// A new stream continues when it replaces a stream that a pose beyond the limits has ended.
static void streams(bcap::Controller &cell) {
    bcap_stream_options options{};
    options.mode = 2;
    bcap::Arm arm = cell.recover(true);
    bcap::Stream stream = arm.stream(options);
    bcap::Joints joints = stream.joints();
    joints[0] += 45;
    CHECK(!steps(stream, joints));
    // on a busy machine the controller's buffer can run empty; then the stream is made again
    for (int attempt = 1;; attempt++) {
        arm = cell.recover(true);
        stream = arm.stream(options);
        joints = stream.joints();
        if (steps(stream, joints))
            break;
        CHECK(attempt < 50);
    }
}

int main(int argc, char **argv) {
    CHECK(argc > 1);
    bcap::Controller cell(argv[1], BCAP_RC8);
    arms(cell);
    streams(cell);
    cell.close();
    std::puts("objects: ok");
    return 0;
}
