/*
 * bcap.h: b-CAP and RAC for DENSO robot controllers.
 *
 * Written by cbindgen from the Rust code: std-adapter/c/test --header
 *
 *   bcap_client_...   sans-IO, for firmware: no heap, no socket, no clock, in memory of the caller
 *   bcap_rac_...      lines of RAC, for firmware
 *   bcap_value_...    values, for both
 *   all others        hosted, for operating systems: blocking functions on a controller
 *
 * Rules for all functions:
 *
 * - A pointer is null, or points to memory that is valid for what the function does with it. Null and misaligned pointers return
 *   BCAP_E_POINTER. Buffers of one call do not overlap.
 * - Text is UTF-8 and ends with NUL.
 * - A struct bcap_client is used by one thread at a time. Handles of the hosted functions may be shared by threads. A handle that
 *   was closed returns BCAP_E_HANDLE.
 * - A handle belongs to the process that opened it. In a forked process it returns BCAP_E_HANDLE, and the end of that process does
 *   not end the session of its parent.
 * - Only BCAP_OK is a success: BCAP_E_... is an error of this library, and a negative status is the HRESULT of the controller.
 */

#ifndef BCAP_H
#define BCAP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* The status of a function. */
enum {
    /* success */
    BCAP_OK = 0,
    /* a pointer is null or misaligned, or buffers overlap; pass memory of its own for each argument */
    BCAP_E_POINTER = 1,
    /* the object was not initialised, was closed, or was copied; open it, and use it where it was opened */
    BCAP_E_HANDLE = 2,
    /* the buffer is too short for the result; pass a longer one */
    BCAP_E_SHORT = 3,
    /* the value is null, not UTF-8 or of a type that cannot be sent; make it with a function such as bcap_i4 */
    BCAP_E_VALUE = 4,
    /* the text is not UTF-8, or not in the required form */
    BCAP_E_TEXT = 5,
    /* the value has another type than was asked for; its field `type` names it */
    BCAP_E_TYPE = 6,
    /* a number is out of range, or the value does not fit the type that was asked for without loss */
    BCAP_E_RANGE = 7,
    /* another call is in flight; wait for its end */
    BCAP_E_BUSY = 8,
    /* the call does not fit the largest frame of the link, or the transmit buffer; nothing was sent */
    BCAP_E_TOO_LARGE = 9,
    /* no reply in time; the controller may have executed the call */
    BCAP_E_TIMEOUT = 10,
    /* the peer sent invalid bytes; is it a b-CAP server? On a stream the session has ended */
    BCAP_E_MALFORMED = 11,
    /* the peer floods this client with replies; the session has ended */
    BCAP_E_FLOODED = 12,
    /* the reply does not fit the receive buffer; the controller executed the call */
    BCAP_E_REPLY_TOO_LARGE = 13,
    /* the session has ended, or the connection is lost; the controller has not executed the call; connect again */
    BCAP_E_CLOSED = 14,
    /* the connection was lost during the call, which the controller may have executed; connect again */
    BCAP_E_LOST = 15,
    /* the address is invalid; write tcp:HOST[:PORT], udp:HOST[:PORT] or serial:PATH */
    BCAP_E_ADDRESS = 16,
    /* the connection failed; are address, port and cable right, and is the controller on? */
    BCAP_E_CONNECT = 17,
    /* the name of the variable or object is invalid; write I1, robot/@SERVO_ON or task:Pro1/@STATUS */
    BCAP_E_PATH = 18,
    /* the arm is not taken, or was lost with the connection; call bcap_take_arm */
    BCAP_E_ARM = 19,
    /* the robot was halted and rests elsewhere; recover before the next motion */
    BCAP_E_HALTED = 20,
    /* the robot rests, and whether at the destination is unknown; read its position */
    BCAP_E_UNSURE = 21,
    /* the motion took longer than its time limit, and the robot was halted */
    BCAP_E_MOTION_TIMEOUT = 22,
    /* the robot may still move; use the emergency stop */
    BCAP_E_NOT_HALTED = 23,
    /* no motion was started; call bcap_start */
    BCAP_E_NO_MOTION = 24,
    /* Slave Mode failed; bcap_message says why. The robot does not follow poses */
    BCAP_E_STREAM = 25,
    /* a stream of Slave Mode runs on this connection; end it with bcap_stream_finish */
    BCAP_E_STREAMING = 26,
    /* no stream of Slave Mode runs; call bcap_stream_start */
    BCAP_E_NO_STREAM = 27,
    /* the robot is not ready; bcap_message names the step that failed, and what to do */
    BCAP_E_RECOVERY = 28,
    /* a log callback called the library; return from it first */
    BCAP_E_REENTRANT = 29,
    /* a defect of the library; the object is closed and its robot halted. Please report bcap_message */
    BCAP_E_PANIC = 30,
    /* there is no reply to read; poll until BCAP_EVENT_REPLIED */
    BCAP_E_NO_REPLY = 31,
    /* the call failed; bcap_message says why */
    BCAP_E_FAILED = 32,
};

/* VARTYPEs; BCAP_ARRAY is added for arrays. */
enum {
    BCAP_EMPTY = 0,
    BCAP_NULL = 1,
    BCAP_I2 = 2,
    BCAP_I4 = 3,
    BCAP_R4 = 4,
    BCAP_R8 = 5,
    BCAP_CY = 6,
    BCAP_DATE = 7,
    BCAP_BSTR = 8,
    BCAP_ERROR = 10,
    BCAP_BOOL = 11,
    BCAP_VARIANT = 12,
    BCAP_UI1 = 17,
    BCAP_UI2 = 18,
    BCAP_UI4 = 19,
    BCAP_I8 = 20,
    BCAP_UI8 = 21,
    BCAP_ARRAY = 0x2000,
};

/* The functions of b-CAP. */
enum {
    BCAP_FN_SERVICE_START = 1,
    BCAP_FN_SERVICE_STOP = 2,
    BCAP_FN_CONTROLLER_CONNECT = 3,
    BCAP_FN_CONTROLLER_DISCONNECT = 4,
    BCAP_FN_CONTROLLER_GET_EXTENSION = 5,
    BCAP_FN_CONTROLLER_GET_FILE = 6,
    BCAP_FN_CONTROLLER_GET_ROBOT = 7,
    BCAP_FN_CONTROLLER_GET_TASK = 8,
    BCAP_FN_CONTROLLER_GET_VARIABLE = 9,
    BCAP_FN_CONTROLLER_GET_COMMAND = 10,
    BCAP_FN_CONTROLLER_GET_EXTENSION_NAMES = 11,
    BCAP_FN_CONTROLLER_GET_FILE_NAMES = 12,
    BCAP_FN_CONTROLLER_GET_ROBOT_NAMES = 13,
    BCAP_FN_CONTROLLER_GET_TASK_NAMES = 14,
    BCAP_FN_CONTROLLER_GET_VARIABLE_NAMES = 15,
    BCAP_FN_CONTROLLER_GET_COMMAND_NAMES = 16,
    BCAP_FN_CONTROLLER_EXECUTE = 17,
    BCAP_FN_CONTROLLER_GET_MESSAGE = 18,
    BCAP_FN_CONTROLLER_GET_ATTRIBUTE = 19,
    BCAP_FN_CONTROLLER_GET_HELP = 20,
    BCAP_FN_CONTROLLER_GET_NAME = 21,
    BCAP_FN_CONTROLLER_GET_TAG = 22,
    BCAP_FN_CONTROLLER_PUT_TAG = 23,
    BCAP_FN_CONTROLLER_GET_ID = 24,
    BCAP_FN_CONTROLLER_PUT_ID = 25,
    BCAP_FN_EXTENSION_GET_VARIABLE = 26,
    BCAP_FN_EXTENSION_GET_VARIABLE_NAMES = 27,
    BCAP_FN_EXTENSION_EXECUTE = 28,
    BCAP_FN_EXTENSION_GET_ATTRIBUTE = 29,
    BCAP_FN_EXTENSION_GET_HELP = 30,
    BCAP_FN_EXTENSION_GET_NAME = 31,
    BCAP_FN_EXTENSION_GET_TAG = 32,
    BCAP_FN_EXTENSION_PUT_TAG = 33,
    BCAP_FN_EXTENSION_GET_ID = 34,
    BCAP_FN_EXTENSION_PUT_ID = 35,
    BCAP_FN_EXTENSION_RELEASE = 36,
    BCAP_FN_FILE_GET_FILE = 37,
    BCAP_FN_FILE_GET_VARIABLE = 38,
    BCAP_FN_FILE_GET_FILE_NAMES = 39,
    BCAP_FN_FILE_GET_VARIABLE_NAMES = 40,
    BCAP_FN_FILE_EXECUTE = 41,
    BCAP_FN_FILE_COPY = 42,
    BCAP_FN_FILE_DELETE = 43,
    BCAP_FN_FILE_MOVE = 44,
    BCAP_FN_FILE_RUN = 45,
    BCAP_FN_FILE_GET_DATE_CREATED = 46,
    BCAP_FN_FILE_GET_DATE_LAST_ACCESSED = 47,
    BCAP_FN_FILE_GET_DATE_LAST_MODIFIED = 48,
    BCAP_FN_FILE_GET_PATH = 49,
    BCAP_FN_FILE_GET_SIZE = 50,
    BCAP_FN_FILE_GET_TYPE = 51,
    BCAP_FN_FILE_GET_VALUE = 52,
    BCAP_FN_FILE_PUT_VALUE = 53,
    BCAP_FN_FILE_GET_ATTRIBUTE = 54,
    BCAP_FN_FILE_GET_HELP = 55,
    BCAP_FN_FILE_GET_NAME = 56,
    BCAP_FN_FILE_GET_TAG = 57,
    BCAP_FN_FILE_PUT_TAG = 58,
    BCAP_FN_FILE_GET_ID = 59,
    BCAP_FN_FILE_PUT_ID = 60,
    BCAP_FN_FILE_RELEASE = 61,
    BCAP_FN_ROBOT_GET_VARIABLE = 62,
    BCAP_FN_ROBOT_GET_VARIABLE_NAMES = 63,
    BCAP_FN_ROBOT_EXECUTE = 64,
    BCAP_FN_ROBOT_ACCELERATE = 65,
    BCAP_FN_ROBOT_CHANGE = 66,
    BCAP_FN_ROBOT_CHUCK = 67,
    BCAP_FN_ROBOT_DRIVE = 68,
    BCAP_FN_ROBOT_GO_HOME = 69,
    BCAP_FN_ROBOT_HALT = 70,
    BCAP_FN_ROBOT_HOLD = 71,
    BCAP_FN_ROBOT_MOVE = 72,
    BCAP_FN_ROBOT_ROTATE = 73,
    BCAP_FN_ROBOT_SPEED = 74,
    BCAP_FN_ROBOT_UNCHUCK = 75,
    BCAP_FN_ROBOT_UNHOLD = 76,
    BCAP_FN_ROBOT_GET_ATTRIBUTE = 77,
    BCAP_FN_ROBOT_GET_HELP = 78,
    BCAP_FN_ROBOT_GET_NAME = 79,
    BCAP_FN_ROBOT_GET_TAG = 80,
    BCAP_FN_ROBOT_PUT_TAG = 81,
    BCAP_FN_ROBOT_GET_ID = 82,
    BCAP_FN_ROBOT_PUT_ID = 83,
    BCAP_FN_ROBOT_RELEASE = 84,
    BCAP_FN_TASK_GET_VARIABLE = 85,
    BCAP_FN_TASK_GET_VARIABLE_NAMES = 86,
    BCAP_FN_TASK_EXECUTE = 87,
    BCAP_FN_TASK_START = 88,
    BCAP_FN_TASK_STOP = 89,
    BCAP_FN_TASK_DELETE = 90,
    BCAP_FN_TASK_GET_FILE_NAME = 91,
    BCAP_FN_TASK_GET_ATTRIBUTE = 92,
    BCAP_FN_TASK_GET_HELP = 93,
    BCAP_FN_TASK_GET_NAME = 94,
    BCAP_FN_TASK_GET_TAG = 95,
    BCAP_FN_TASK_PUT_TAG = 96,
    BCAP_FN_TASK_GET_ID = 97,
    BCAP_FN_TASK_PUT_ID = 98,
    BCAP_FN_TASK_RELEASE = 99,
    BCAP_FN_VARIABLE_GET_DATE_TIME = 100,
    BCAP_FN_VARIABLE_GET_VALUE = 101,
    BCAP_FN_VARIABLE_PUT_VALUE = 102,
    BCAP_FN_VARIABLE_GET_ATTRIBUTE = 103,
    BCAP_FN_VARIABLE_GET_HELP = 104,
    BCAP_FN_VARIABLE_GET_NAME = 105,
    BCAP_FN_VARIABLE_GET_TAG = 106,
    BCAP_FN_VARIABLE_PUT_TAG = 107,
    BCAP_FN_VARIABLE_GET_ID = 108,
    BCAP_FN_VARIABLE_PUT_ID = 109,
    BCAP_FN_VARIABLE_GET_MICROSECOND = 110,
    BCAP_FN_VARIABLE_RELEASE = 111,
    BCAP_FN_COMMAND_EXECUTE = 112,
    BCAP_FN_COMMAND_CANCEL = 113,
    BCAP_FN_COMMAND_GET_TIMEOUT = 114,
    BCAP_FN_COMMAND_PUT_TIMEOUT = 115,
    BCAP_FN_COMMAND_GET_STATE = 116,
    BCAP_FN_COMMAND_GET_PARAMETERS = 117,
    BCAP_FN_COMMAND_PUT_PARAMETERS = 118,
    BCAP_FN_COMMAND_GET_RESULT = 119,
    BCAP_FN_COMMAND_GET_ATTRIBUTE = 120,
    BCAP_FN_COMMAND_GET_HELP = 121,
    BCAP_FN_COMMAND_GET_NAME = 122,
    BCAP_FN_COMMAND_GET_TAG = 123,
    BCAP_FN_COMMAND_PUT_TAG = 124,
    BCAP_FN_COMMAND_GET_ID = 125,
    BCAP_FN_COMMAND_PUT_ID = 126,
    BCAP_FN_COMMAND_RELEASE = 127,
    BCAP_FN_MESSAGE_REPLY = 128,
    BCAP_FN_MESSAGE_CLEAR = 129,
    BCAP_FN_MESSAGE_GET_DATE_TIME = 130,
    BCAP_FN_MESSAGE_GET_DESCRIPTION = 131,
    BCAP_FN_MESSAGE_GET_DESTINATION = 132,
    BCAP_FN_MESSAGE_GET_NUMBER = 133,
    BCAP_FN_MESSAGE_GET_SERIAL_NUMBER = 134,
    BCAP_FN_MESSAGE_GET_SOURCE = 135,
    BCAP_FN_MESSAGE_GET_VALUE = 136,
    BCAP_FN_MESSAGE_RELEASE = 137,
};


// The robot rests exactly at the destination.
#define BCAP_PASS_EXACT 0

// The commanded position reaches the destination; the arm may lag behind it.
#define BCAP_PASS_COMMANDED -1

// The robot passes near the destination, at a distance that the controller chooses.
#define BCAP_PASS_NEAR -2

// A failure.
#define BCAP_LOG_ERROR 1

// A surprise, such as a robot that was not halted.
#define BCAP_LOG_WARN 2

// Connections and sessions.
#define BCAP_LOG_INFO 3

// Calls.
#define BCAP_LOG_DEBUG 4

// The result of a function: `BCAP_OK`, a positive code `BCAP_E_...` of this library, or the negative HRESULT of the controller.
// `bcap_status_text` explains all of them.
typedef int32_t bcap_status;

// A client in memory of the caller. Its content is private; it must not be moved or copied. Fill it with zeros before
// `bcap_client_init`, so that functions recognise a client that was not initialised.
typedef struct {
    // Private.
    uint64_t private_[40];
} bcap_client;

// The link of a client.
typedef int32_t bcap_link;

// The content of a value.
typedef union {
    // Integers, truth values, codes, and currency in ten-thousandths. Unsigned numbers of 64 bits have the same bits.
    int64_t integer;
    // R4, R8 and DATE.
    double number;
    // Text and arrays.
    const void *pointer;
} bcap_data;

// A value (VARIANT) of a call or of a reply. `type`, `count` and for numbers `data` can be read; functions make it and read the rest.
//
// It points to the memory of its text or array, which must not change while the value is used. A value of a reply points into the
// buffer that received it.
typedef struct {
    // The VARTYPE, such as `BCAP_I4`, or `BCAP_ARRAY | BCAP_R8`.
    uint16_t type;
    // Private.
    uint16_t form;
    // The number of elements of an array; otherwise 1.
    uint32_t count;
    // Private.
    size_t size;
    // The content.
    bcap_data data;
} bcap_value;

// What `bcap_client_poll` reports.
typedef int32_t bcap_event_kind;

// An event of a client.
typedef struct {
    // One of `BCAP_EVENT_...`.
    bcap_event_kind kind;
    // The result of a call that has ended; otherwise `BCAP_OK`.
    bcap_status status;
} bcap_event;

// A controller: a session with its objects. A handle of zeros is invalid. Threads may share it; their calls follow each other.
typedef struct {
    // Private.
    uint64_t id;
} bcap_controller;

// A motion. Fields that are 0 have the meaning that is stated.
typedef struct {
    // The destination: a variable (`P1`, `J3`), or a pose as the controller writes it (`J(0, 45, 90, 0, 45, 0)`).
    const char *to;
    // The speed in percent; 0 is 10 %.
    double speed_percent;
    // How the motion ends: one of `BCAP_PASS_...`, or a positive distance in mm at which the next motion may begin.
    int32_t pass;
    // Whether the tool moves along a line; otherwise all joints move at the same time.
    bool line;
} bcap_motion;

// Halts a robot from any thread, while another thread waits for a motion. It has a separate connection.
typedef struct {
    // Private.
    uint64_t id;
} bcap_stopper;

// The model of a controller, which determines its provider.
typedef int32_t bcap_model;

// A callback of the log. It gets one of `BCAP_LOG_...` and a text that is valid until it returns. Any thread may call it. It must not
// call the library, and must not unwind.
typedef void (*bcap_log)(int32_t level, const char *message, void *user);

// How poses are streamed. Fields that are 0 have the default that is stated.
typedef struct {
    // The maximum speed of each joint in degrees or mm per second; 0 is 30. A pose beyond it is not sent, and the robot stops.
    double speed;
    // The maximum acceleration of each joint, per second squared; 0 is 300.
    double acceleration;
    // Maximum time that the program may take for a pose, in ms; 0 is 100. After that the robot stops in an orderly way.
    uint32_t pose_timeout_ms;
    // The mode of Slave Mode: 1 paces by the clock of this computer; 0 and 2 by the buffer of the controller.
    int32_t mode;
} bcap_stream_options;

// The counts of a stream.
typedef struct {
    // Poses that the controller stored.
    uint32_t cycles;
    // Poses that were sent late.
    uint32_t late;
    // Number of times that the controller's buffer was empty while the robot moved.
    uint32_t underflows;
} bcap_stream_stats;

// A stream: TCP.
#define BCAP_LINK_STREAM 0

// Datagrams: UDP. Calls are sent again when replies are lost.
#define BCAP_LINK_DATAGRAM 1

// A serial line; its frames have a CRC.
#define BCAP_LINK_SERIAL 2

// No event: move bytes, or wait until the deadline.
#define BCAP_EVENT_NONE 0

// The reply arrived; `status` is its result, and `bcap_client_value` its value.
#define BCAP_EVENT_REPLIED 1

// The call ended without a reply; `status` says why.
#define BCAP_EVENT_FAILED 2

// The controller still executes the call.
#define BCAP_EVENT_EXECUTING 3

// The client sends the call again.
#define BCAP_EVENT_RETRIED 4

// A reply that belongs to no call, or invalid bytes, were dropped.
#define BCAP_EVENT_DROPPED 5

// RC8 and RC8A.
#define BCAP_RC8 8

// RC9 and COBOTTA PRO.
#define BCAP_RC9 9

// COBOTTA.
#define BCAP_COBOTTA 1

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Initialises a client with two buffers: `tx` for a request, `rx` for a reply. 512 bytes each suit most boards. The buffers belong to
// the client until it is initialised again or its memory is no longer used; it needs no end.
bcap_status bcap_client_init(bcap_client *client,
                             bcap_link link,
                             uint8_t *tx,
                             size_t tx_size,
                             uint8_t *rx,
                             size_t rx_size);

// Ends the use of a client: each later call returns `BCAP_E_HANDLE`. The buffers belong to the caller again.
bcap_status bcap_client_deinit(bcap_client *client);

// Prepares for a new connection: drops the call in flight and all received bytes.
bcap_status bcap_client_reset(bcap_client *client);

// Sets the time limits of further calls: how long an attempt waits, the number of attempts on a link that loses frames, and how long a
// call may take in total. The defaults are 3 s, one attempt and 180 s for a stream, and five attempts of 500 ms otherwise.
bcap_status bcap_client_set_timing(bcap_client *client,
                                   uint32_t attempt_ms,
                                   uint8_t attempts,
                                   uint32_t deadline_ms);

// Sets the serial of the next call. Over UDP begin with a random one, so that replies to an earlier client are recognised.
bcap_status bcap_client_set_serial(bcap_client *client,
                                   uint16_t serial);

// Starts a call: `function` is one of `BCAP_FN_...`. `bcap_client_transmit` then returns its bytes. `now_us` is the time of any clock
// that never goes back, in microseconds.
bcap_status bcap_client_start(bcap_client *client,
                              int32_t function,
                              const bcap_value *arguments,
                              size_t count,
                              uint64_t now_us);

// Returns the bytes to send: one datagram, or the rest of a frame. `count` is 0 if there are no bytes to send.
bcap_status bcap_client_transmit(bcap_client *client,
                                 const uint8_t **bytes,
                                 size_t *count);

// Records that the link has taken `count` bytes of `bcap_client_transmit`.
bcap_status bcap_client_transmitted(bcap_client *client, size_t count);

// Returns memory for received bytes; `size` is 0 when there is no room. The values of earlier replies are invalid then.
bcap_status bcap_client_receive_buffer(bcap_client *client,
                                       uint8_t **bytes,
                                       size_t *size);

// Records that `count` bytes were put into the memory of `bcap_client_receive_buffer`.
bcap_status bcap_client_received(bcap_client *client, size_t count);

// Handles received bytes and the time, and reports the next event. Call it until it reports `BCAP_EVENT_NONE`.
bcap_status bcap_client_poll(bcap_client *client,
                             uint64_t now_us,
                             bcap_event *event);

// Returns when `bcap_client_poll` must be called even if no bytes arrive, in microseconds; `UINT64_MAX` while no call is in flight.
bcap_status bcap_client_deadline(bcap_client *client,
                                 uint64_t *at_us);

// Returns the value of the reply; EMPTY if it has no value. It points into the receive buffer, until
// `bcap_client_receive_buffer` or `bcap_client_start`.
bcap_status bcap_client_value(bcap_client *client, bcap_value *value);

// Abandons the call in flight. Its reply is then dropped; the controller may execute it.
bcap_status bcap_client_abandon(bcap_client *client);

// Explains a status: writes its name, its meaning and what to do to `buffer`, shortened to `size` bytes with NUL, and returns the
// length of the whole text, as `snprintf` does. `buffer` may be null to query the length.
size_t bcap_status_text(bcap_status status,
                        char *buffer,
                        size_t size);

// Writes the text of the last hosted function that failed on this thread: what was wrong, where, and what to do. It is shortened to
// `size` bytes with NUL. Returns the length of the whole text, as `snprintf` does; 0 if no function has failed.
size_t bcap_message(char *buffer,
                    size_t size);

// Takes the arm of the robot, so that this session can move it.
bcap_status bcap_take_arm(bcap_controller cell);

// Halts a running motion, switches the motor off if this session has switched it on, and gives the arm back.
bcap_status bcap_give_arm(bcap_controller cell);

// Switches the motor on or off, and waits until it is.
bcap_status bcap_motor(bcap_controller cell, bool on);

// Sets the external speed in percent of the maximum, which scales the speed of motions.
bcap_status bcap_set_speed(bcap_controller cell, double percent);

// Moves, and waits until the motion ends, at most `limit_ms`; the robot is halted then. `BCAP_OK` says that the robot rests at the
// destination. Any other status says how the motion ended: see `bcap_status_text` and `bcap_message`.
bcap_status bcap_move(bcap_controller cell,
                      const bcap_motion *motion_,
                      uint32_t limit_ms);

// Starts a motion, and returns when it has begun. Variables can be read and written until `bcap_wait` or `bcap_halt` ends it.
// If a motion is running, this motion follows it. `limit_ms` of the first motion is the time limit of all.
bcap_status bcap_start(bcap_controller cell,
                       const bcap_motion *motion_,
                       uint32_t limit_ms);

// Waits until the motions of `bcap_start` end; the status is the outcome, as for `bcap_move`.
bcap_status bcap_wait(bcap_controller cell);

// Halts the robot, even without the arm, and waits until it rests. After any status other than `BCAP_OK` it may still move.
// While another thread waits for a motion, use `bcap_stopper_halt`.
bcap_status bcap_halt(bcap_controller cell);

// Recovers the robot after an error: clears the errors, takes the arm and switches the motor on. **The arm of a COBOTTA can move**, so
// a person must have looked at the robot. `is_alone` says that no other client uses the robot.
bcap_status bcap_recover(bcap_controller cell,
                         bool is_alone);

// Reads the joints in degrees or mm; joints that the robot does not have are 0.
bcap_status bcap_joints(bcap_controller cell, double *joints);

// Opens a second connection, over which any thread can halt the robot at any time. Open it before the first motion. It is not an
// emergency stop: it needs the network, this computer and the controller.
bcap_status bcap_stopper_open(bcap_controller cell,
                              bcap_stopper *stopper);

// Halts the robot, and waits until it rests. After another status than `BCAP_OK` it may still move.
bcap_status bcap_stopper_halt(bcap_stopper stopper);

// Closes a stopper.
bcap_status bcap_stopper_close(bcap_stopper stopper);

// Connects to the controller at `tcp:HOST[:PORT]`, `udp:HOST[:PORT]` or `serial:PATH`, and starts a session.
//
// `bcap_close` ends it. The end of the program does too: it halts the robot, switches the motor off and gives the arm back.
bcap_status bcap_connect(const char *address,
                         bcap_model model,
                         bcap_controller *controller);

// Halts a motion, gives the arm back, releases all objects and disconnects. The handle is then invalid, even after a failure.
bcap_status bcap_close(bcap_controller cell);

// Reads a variable, such as `I1`, `IO128`, `robot/@SERVO_ON` or `task:Pro1/@STATUS`, as an integer or a truth value.
bcap_status bcap_read_integer(bcap_controller cell,
                              const char *name,
                              int64_t *integer);

// Reads a variable as a number.
bcap_status bcap_read_number(bcap_controller cell, const char *name, double *number);

// Reads a variable as text of UTF-8 into `buffer`, with NUL. Text that does not fit is cut, and the result is `BCAP_E_SHORT`.
bcap_status bcap_read_text(bcap_controller cell,
                           const char *name,
                           char *buffer,
                           size_t size);

// Reads a variable as numbers: P has 7, V 3, J 8, T 10. `numbers` has room for `capacity` of them, and `count` gets their number.
bcap_status bcap_read_numbers(bcap_controller cell,
                              const char *name,
                              double *numbers,
                              size_t capacity,
                              size_t *count);

// Reads a variable of any type into `memory`; `value` points into it.
bcap_status bcap_read(bcap_controller cell,
                      const char *name,
                      uint8_t *memory,
                      size_t size,
                      bcap_value *value);

// Writes a variable: `bcap_write(cell, "I1", bcap_i4(5))`. After `BCAP_E_TIMEOUT` and `BCAP_E_LOST` it may have been written.
bcap_status bcap_write(bcap_controller cell,
                       const char *name,
                       bcap_value value);

// Opens an object, such as `robot`, `task:Pro1` or `file:a.pcs`, and returns its handle for `bcap_call`. It is released with the
// session, or by a call such as `BCAP_FN_TASK_RELEASE`.
bcap_status bcap_open(bcap_controller cell,
                      const char *path,
                      int32_t *handle);

// Makes any of the 137 calls, and stores the value of the reply in `memory`, unless `value` is null. A call that moves the robot
// returns when the motion has ended. If the value does not fit (`BCAP_E_SHORT`), the controller has executed the call.
bcap_status bcap_call(bcap_controller cell,
                      int32_t function,
                      const bcap_value *arguments,
                      size_t count,
                      uint8_t *memory,
                      size_t size,
                      bcap_value *value);

// Executes a command of the controller with a parameter, such as `ClearError` with `bcap_empty()`. As `bcap_call` otherwise.
bcap_status bcap_execute(bcap_controller cell,
                         const char *command,
                         bcap_value parameter,
                         uint8_t *memory,
                         size_t size,
                         bcap_value *value);

// Executes a command of the robot with a parameter, such as `CurJnt` with `bcap_empty()`. As `bcap_call` otherwise.
bcap_status bcap_execute_robot(bcap_controller cell,
                               const char *command,
                               bcap_value parameter,
                               uint8_t *memory,
                               size_t size,
                               bcap_value *value);

// Sends the log of a level and of more serious ones to a callback; null ends it. When it returns, an earlier callback no longer runs.
bcap_status bcap_set_log(bcap_log callback,
                         int32_t level,
                         void *user);

// Starts a stream of joints (8 numbers, in degrees or mm), and returns the joints at its start. The arm must be taken and the motor on.
// Until `bcap_stream_finish` other functions of this controller return `BCAP_E_STREAMING`.
bcap_status bcap_stream_start(bcap_controller cell,
                              const bcap_stream_options *options,
                              double *joints);

// Sends the joints of the next cycle, and waits for the cycle after it, 8 ms later. `actual` gets the joints that the controller
// reports; it may be null. Any status other than `BCAP_OK` ends the stream: the robot stops, and does not follow further
// poses.
bcap_status bcap_stream_step(bcap_controller cell,
                             const double *joints,
                             double *actual);

// Ends the stream: the robot comes to rest at the last pose, and Slave Mode is left. `stats` may be null.
bcap_status bcap_stream_finish(bcap_controller cell, bcap_stream_stats *stats);

// Writes the line that reads a variable, such as `I10`: `GET:RC8:10:I:` and CR. 256 bytes hold any line. `length` gets its length; it
// does not end with NUL.
bcap_status bcap_rac_get(const char *name,
                         char *line,
                         size_t size,
                         size_t *length);

// Writes the line that sets a variable: `PUT:RC8:10:I:3,123` and CR.
bcap_status bcap_rac_put(const char *name, const bcap_value *value, char *line, size_t size, size_t *length);

// Reads the line of a reply, without its CR. `memory` gets the value's text or array, and must not overlap the line; 1024 bytes hold
// any value. The result is the controller's if it refused.
bcap_status bcap_rac_reply(const char *line,
                           size_t length,
                           uint8_t *memory,
                           size_t size,
                           bcap_value *value);

// Makes EMPTY, the value of a call without one.
bcap_value bcap_empty(void);

// Creates an integer, a truth value, a code or a currency amount of any scalar type, such as `BCAP_UI2`. An integer out of
// range of its type is refused when it is sent. For `BCAP_R4`, `BCAP_R8` and `BCAP_DATE` it is converted to the nearest
// number.
bcap_value bcap_integer(uint16_t type,
                        int64_t integer);

// Creates an I4: handles, I variables, modes.
bcap_value bcap_i4(int32_t integer);

// Creates a BOOL: IO variables.
bcap_value bcap_bool(bool truth);

// Creates an R4: F variables, speeds.
bcap_value bcap_r4(float number);

// Creates an R8: D variables.
bcap_value bcap_r8(double number);

// Creates a text of UTF-8 that ends with NUL: names, options, S variables. Null creates a value that is refused.
bcap_value bcap_text(const char *text);

// Creates an array of numbers, such as `BCAP_R4` from `float` and `BCAP_I4` from `int32_t`. A BOOL is an `int16_t`, 0 or -1.
bcap_value bcap_array(uint16_t type,
                      const void *elements,
                      size_t count);

// Creates an array of values of any types (VARIANT), such as the pose of Robot_Move.
bcap_value bcap_list(const bcap_value *values, size_t count);

// Reads a value as an integer: any number that has no fraction, or a truth value.
bcap_status bcap_value_integer(const bcap_value *value, int64_t *integer);

// Reads a value as a number: any number that a double holds without loss.
bcap_status bcap_value_number(const bcap_value *value, double *number);

// Reads a text as UTF-8 into `buffer`, with NUL. Text that does not fit is cut, and the result is `BCAP_E_SHORT`.
bcap_status bcap_value_text(const bcap_value *value,
                            char *buffer,
                            size_t size);

// Reads an array of numbers into `numbers`, which has room for `capacity` of them. `count` gets their number; it may be null.
bcap_status bcap_value_numbers(const bcap_value *value,
                               double *numbers,
                               size_t capacity,
                               size_t *count);

// Reads an element of a received array of any type; the first has the index 0. It points into the same memory.
bcap_status bcap_value_element(const bcap_value *value,
                               size_t index,
                               bcap_value *element);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* BCAP_H */
