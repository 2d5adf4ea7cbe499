// bcap.hpp: the hosted functions of bcap.h for C++17: objects that end what they began, and exceptions. Header-only.
//
//   bcap::Controller cell("tcp:192.168.0.1", BCAP_RC8);
//   auto count = cell.read<int>("I1");
//   cell.write("I1", count + 1);
//   bcap::Arm arm = cell.take_arm();
//   arm.motor(true);
//   arm.move(bcap::line("P1").speed(10), std::chrono::seconds(30));
//
// An Arm and a Stream must not outlive their Controller.
#ifndef BCAP_HPP
#define BCAP_HPP

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "bcap.h"

namespace bcap {

using Milliseconds = std::chrono::milliseconds;

/// A failed call. `what` says which object, which call and what to do.
class Error : public std::runtime_error {
public:
    Error(bcap_status status, const std::string &text) : std::runtime_error(text), status_(status) {}

    /// BCAP_E_..., or the negative code of the controller.
    bcap_status status() const noexcept { return status_; }

private:
    bcap_status status_;
};

/// The robot did not arrive at the destination of a motion.
class NotArrived : public Error {
    using Error::Error;
};

/// Returns the text of a status.
inline std::string text(bcap_status status) {
    std::string text(bcap_status_text(status, nullptr, 0), '\0');
    bcap_status_text(status, text.data(), text.size() + 1);
    return text;
}

/// Throws unless a call succeeded.
inline void check(bcap_status status) {
    if (status == BCAP_OK)
        return;
    std::string message(bcap_message(nullptr, 0), '\0');
    bcap_message(message.data(), message.size() + 1);
    switch (status) {
    case BCAP_E_HALTED:
    case BCAP_E_UNSURE:
    case BCAP_E_MOTION_TIMEOUT:
        throw NotArrived(status, message);
    default:
        throw Error(status, message);
    }
}

/// A motion: `bcap::line("P1").speed(10)`.
class Motion {
public:
    Motion(std::string to, bool line) : to_(std::move(to)), line_(line) {}

    /// Sets the speed in percent; the default is 10.
    Motion speed(double percent) const {
        Motion motion = *this;
        motion.speed_ = percent;
        return motion;
    }

    /// Sets BCAP_PASS_..., or the distance in mm at which the next motion may begin.
    Motion pass(std::int32_t pass) const {
        Motion motion = *this;
        motion.pass_ = pass;
        return motion;
    }

    /// Returns the structure of C, which points to this object.
    bcap_motion get() const noexcept { return {to_.c_str(), speed_, pass_, line_}; }

private:
    std::string to_;
    double speed_ = 10;
    std::int32_t pass_ = BCAP_PASS_EXACT;
    bool line_;
};

inline Motion line(std::string to) { return {std::move(to), true}; }
inline Motion joint(std::string to) { return {std::move(to), false}; }

using Joints = std::array<double, 8>;

/// A number that is closed once, when its last owner ends. It can be moved, not copied. Assigning the same number does not close it.
template <class Handle, bcap_status (*Close)(Handle)> class Owned {
public:
    explicit Owned(Handle handle = Handle{0}) noexcept : handle_(handle) {}
    Owned(Owned &&other) noexcept : handle_(other.release()) {}
    Owned &operator=(Owned &&other) noexcept {
        if (this == &other)
            return *this;
        // all arms and streams of a controller have its number, which one of the two must not close
        if (handle_.id == other.handle_.id)
            other.release();
        else
            std::swap(handle_, other.handle_);
        return *this;
    }
    ~Owned() {
        if (handle_.id != 0)
            Close(handle_);
    }
    Handle get() const noexcept { return handle_; }
    Handle release() noexcept { return std::exchange(handle_, Handle{0}); }

private:
    Handle handle_;
};

/// A stream of Slave Mode: `step` sends the joints of the next cycle. Its end lets the robot come to rest. A new stream can be
/// assigned to an old one, but `std::optional::emplace` over an open stream ends the new stream.
class Stream {
public:
    Stream(bcap_controller cell, const bcap_stream_options &options) {
        check(bcap_stream_start(cell, &options, joints_.data()));
        cell_ = Owned<bcap_controller, finish_quietly>(cell);
    }

    /// The joints that the controller reported last, in degrees or mm.
    const Joints &joints() const noexcept { return joints_; }

    /// Sends the joints of the next cycle, and returns those that the controller reports 8 ms later.
    const Joints &step(const Joints &joints) {
        check(bcap_stream_step(cell_.get(), joints.data(), joints_.data()));
        return joints_;
    }

    bcap_stream_stats finish() {
        bcap_stream_stats stats{};
        check(bcap_stream_finish(cell_.release(), &stats));
        return stats;
    }

private:
    static bcap_status finish_quietly(bcap_controller cell) { return bcap_stream_finish(cell, nullptr); }

    Owned<bcap_controller, finish_quietly> cell_;
    Joints joints_{};
};

/// The arm: its end halts the robot, switches the motor off and gives the arm back. A new arm can be assigned to an old one,
/// but `std::optional::emplace` over an open arm ends the new arm.
class Arm {
public:
    explicit Arm(bcap_controller cell) noexcept : cell_(cell) {}

    void motor(bool on) { check(bcap_motor(cell_.get(), on)); }
    void speed(double percent) { check(bcap_set_speed(cell_.get(), percent)); }

    /// Moves, and returns when the robot rests at the destination. Throws NotArrived if it does not within the limit.
    void move(const Motion &motion, Milliseconds limit) {
        const bcap_motion all = motion.get();
        check(bcap_move(cell_.get(), &all, count(limit)));
    }

    /// Starts a motion; `wait` or `halt` ends it. A second motion follows the first.
    void start(const Motion &motion, Milliseconds limit) {
        const bcap_motion all = motion.get();
        check(bcap_start(cell_.get(), &all, count(limit)));
    }

    void wait() { check(bcap_wait(cell_.get())); }
    void halt() { check(bcap_halt(cell_.get())); }
    Stream stream(const bcap_stream_options &options) { return Stream(cell_.get(), options); }

    /// Gives the arm back, and throws if that fails.
    void give() { check(bcap_give_arm(cell_.release())); }

private:
    static std::uint32_t count(Milliseconds limit) {
        const auto most = Milliseconds(std::numeric_limits<std::uint32_t>::max());
        return static_cast<std::uint32_t>(std::clamp(limit, Milliseconds(0), most).count());
    }

    Owned<bcap_controller, bcap_give_arm> cell_;
};

/// Halts the robot from any thread.
class Stopper {
public:
    explicit Stopper(bcap_controller cell) {
        bcap_stopper opened{};
        check(bcap_stopper_open(cell, &opened));
        stopper_ = Owned<bcap_stopper, bcap_stopper_close>(opened);
    }

    void halt() { check(bcap_stopper_halt(stopper_.get())); }

private:
    Owned<bcap_stopper, bcap_stopper_close> stopper_;
};

/// A session with a controller.
class Controller {
public:
    Controller(const std::string &address, bcap_model model) {
        bcap_controller opened{};
        check(bcap_connect(address.c_str(), model, &opened));
        cell_ = Owned<bcap_controller, bcap_close>(opened);
    }

    /// The handle, for functions of bcap.h.
    bcap_controller get() const noexcept { return cell_.get(); }

    /// Reads a variable as an integer, `bool`, `double`, `std::string` or `std::vector<double>`.
    template <class T> T read(const std::string &name) {
        if constexpr (std::is_same_v<T, std::string>) {
            return read_text(name);
        } else if constexpr (std::is_same_v<T, std::vector<double>>) {
            return read_numbers(name);
        } else if constexpr (std::is_floating_point_v<T>) {
            double number = 0;
            check(bcap_read_number(get(), name.c_str(), &number));
            return static_cast<T>(number);
        } else {
            static_assert(std::is_integral_v<T>, "a number, bool, std::string or std::vector<double>");
            std::int64_t integer = 0;
            check(bcap_read_integer(get(), name.c_str(), &integer));
            if constexpr (std::is_same_v<T, bool>) {
                return integer != 0;
            } else if constexpr (std::is_unsigned_v<T>) {
                if (integer < 0 || static_cast<std::uint64_t>(integer) > std::numeric_limits<T>::max())
                    throw Error(BCAP_E_RANGE, name + " does not fit the type");
            } else if (integer < std::numeric_limits<T>::min() || integer > std::numeric_limits<T>::max()) {
                throw Error(BCAP_E_RANGE, name + " does not fit the type");
            }
            return static_cast<T>(integer);
        }
    }

    void write(const std::string &name, bcap_value value) { check(bcap_write(get(), name.c_str(), value)); }
    void write(const std::string &name, std::int32_t integer) { write(name, bcap_i4(integer)); }
    void write(const std::string &name, bool truth) { write(name, bcap_bool(truth)); }
    void write(const std::string &name, float number) { write(name, bcap_r4(number)); }
    void write(const std::string &name, double number) { write(name, bcap_r8(number)); }
    void write(const std::string &name, const std::string &text) { write(name, bcap_text(text.c_str())); }
    // without it, a literal would be a truth value
    void write(const std::string &name, const char *text) { write(name, bcap_text(text)); }
    void write(const std::string &name, const std::vector<float> &numbers) {
        write(name, bcap_array(BCAP_R4, numbers.data(), numbers.size()));
    }

    Joints joints() {
        Joints joints{};
        check(bcap_joints(get(), joints.data()));
        return joints;
    }

    Arm take_arm() {
        check(bcap_take_arm(get()));
        return Arm(get());
    }

    /// Clears errors, takes the arm and switches the motor on. The arm of a COBOTTA can move.
    Arm recover(bool is_alone) {
        check(bcap_recover(get(), is_alone));
        return Arm(get());
    }

    Stopper stopper() { return Stopper(get()); }

    /// Disconnects, and throws if that fails.
    void close() { check(bcap_close(cell_.release())); }

private:
    std::string read_text(const std::string &name) {
        for (std::size_t size = 256;; size *= 16) {
            std::string text(size, '\0');
            const bcap_status status = bcap_read_text(get(), name.c_str(), text.data(), size);
            if (status == BCAP_E_SHORT && size < (1U << 24))
                continue;
            check(status);
            text.resize(text.find('\0'));
            return text;
        }
    }

    std::vector<double> read_numbers(const std::string &name) {
        for (std::size_t count = 16;; count *= 16) {
            std::vector<double> numbers(count);
            std::size_t found = 0;
            const bcap_status status = bcap_read_numbers(get(), name.c_str(), numbers.data(), count, &found);
            if (status == BCAP_E_SHORT && count < (1U << 20))
                continue;
            check(status);
            numbers.resize(found);
            return numbers;
        }
    }

    Owned<bcap_controller, bcap_close> cell_;
};

} // namespace bcap

#endif
