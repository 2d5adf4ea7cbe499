/* Tests of the hosted client against the virtual controller: hosted ADDRESS [slow|leave|left] */
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "check.h"

static const char *address;
/* Under valgrind the program can be too slow for the cycle of Slave Mode. */
static bool is_slow;

static bcap_controller connected(void) {
    bcap_controller cell;
    OK(bcap_connect(address, BCAP_RC8, &cell));
    return cell;
}

/* Whether the text of the last failure on this thread contains a part. */
static bool says(const char *part) {
    char text[512];
    return bcap_message(text, sizeof text) > 0 && strstr(text, part) != NULL;
}

/* Checks the text of the last failure on this thread. */
static void message(const char *part) {
    char text[512];
    size_t length = bcap_message(text, sizeof text);
    if (length == 0 || strstr(text, part) == NULL) {
        fprintf(stderr, "\"%s\" is not in \"%s\"\n", part, text);
        exit(1);
    }
}

static void variables(void) {
    bcap_controller cell = connected();
    int64_t integer;
    double number, numbers[10];
    size_t count;
    char text[32];
    uint8_t memory[512];
    bcap_value value, element;

    OK(bcap_write(cell, "I1", bcap_i4(41)));
    OK(bcap_read_integer(cell, "I1", &integer));
    CHECK(integer == 41);
    OK(bcap_read_number(cell, "I1", &number));
    CHECK(number == 41.0);
    OK(bcap_write(cell, "F1", bcap_r4(0.5f)));
    OK(bcap_read_number(cell, "F1", &number));
    CHECK(number == 0.5);
    STATUS(BCAP_E_RANGE, bcap_read_integer(cell, "F1", &integer));
    OK(bcap_write(cell, "IO128", bcap_bool(true)));
    OK(bcap_read_integer(cell, "IO128", &integer));
    CHECK(integer == 1);
    OK(bcap_read_integer(cell, "robot/@SERVO_ON", &integer));
    CHECK(integer == 0);
    OK(bcap_write(cell, "S1", bcap_text("gr\xc3\xbc\xc3\x9f")));
    OK(bcap_read_text(cell, "S1", text, sizeof text));
    CHECK(strcmp(text, "gr\xc3\xbc\xc3\x9f") == 0);
    STATUS(BCAP_E_SHORT, bcap_read_text(cell, "S1", text, 4));
    CHECK(strcmp(text, "gr") == 0);
    STATUS(BCAP_E_TYPE, bcap_read_integer(cell, "S1", &integer));
    message("the value of S1");

    const float pose[7] = {400, 0, 300, 180, 0, 180, 5};
    OK(bcap_write(cell, "P1", bcap_array(BCAP_R4, pose, 7)));
    OK(bcap_read_numbers(cell, "P1", numbers, 10, &count));
    CHECK(count == 7 && numbers[0] == 400.0 && numbers[6] == 5.0);
    STATUS(BCAP_E_SHORT, bcap_read_numbers(cell, "P1", numbers, 6, &count));
    OK(bcap_read(cell, "P1", memory, sizeof memory, &value));
    CHECK(value.type == (BCAP_ARRAY | BCAP_R4) && value.count == 7);
    OK(bcap_value_element(&value, 2, &element));
    OK(bcap_value_number(&element, &number));
    CHECK(number == 300.0);
    STATUS(BCAP_E_SHORT, bcap_read(cell, "P1", memory, 10, &value));

    /* the text of a string of 16,384 characters, which must not end anything */
    static char longest[16385];
    memset(longest, 'a', sizeof longest - 1);
    bcap_status status = bcap_write(cell, "S2", bcap_text(longest));
    CHECK(status == BCAP_OK || status < 0);
    OK(bcap_read_integer(cell, "I1", &integer));

    STATUS((int32_t)0x8002000b, bcap_read_integer(cell, "I99999", &integer));
    message("I99999");
    STATUS(BCAP_E_PATH, bcap_read_integer(cell, "task:/x", &integer));
    STATUS(BCAP_E_TEXT, bcap_read_integer(cell, "\xff", &integer));

    /* any call, any command */
    int32_t task;
    OK(bcap_open(cell, "task:Pro1", &task));
    const bcap_value release = bcap_i4(task);
    OK(bcap_call(cell, BCAP_FN_TASK_RELEASE, &release, 1, NULL, 0, NULL));
    CHECK(bcap_call(cell, BCAP_FN_TASK_RELEASE, &release, 1, NULL, 0, NULL) < 0);
    OK(bcap_execute(cell, "ClearError", bcap_empty(), NULL, 0, NULL));
    OK(bcap_execute_robot(cell, "CurJnt", bcap_empty(), memory, sizeof memory, &value));
    OK(bcap_value_numbers(&value, numbers, 8, &count));
    CHECK(count == 8);
    double joints[8];
    OK(bcap_joints(cell, joints));
    CHECK(joints[0] == numbers[0]);
    OK(bcap_close(cell));
}

static const bcap_motion near = {.to = "J(0, 45, 90, 0, 45, 0)", .speed_percent = 100};
static const bcap_motion far = {.to = "J(120, 45, 90, 0, 45, 0)", .speed_percent = 5};

static void wait_ms(long ms) {
    const struct timespec time = {ms / 1000, ms % 1000 * 1000000};
    nanosleep(&time, NULL);
}

/* Waits until the first joint has moved. */
static void wait_for_motion(bcap_controller cell) {
    double start[8], now[8];
    OK(bcap_joints(cell, start));
    do {
        wait_ms(5);
        OK(bcap_joints(cell, now));
    } while (fabs(now[0] - start[0]) < 0.01);
}

/* Checks that the robot rests, its motor is off and its arm is free. */
static void left(void) {
    bcap_controller cell = connected();
    int64_t on;
    double first[8], second[8];
    OK(bcap_read_integer(cell, "robot/@SERVO_ON", &on));
    OK(bcap_joints(cell, first));
    wait_ms(50);
    OK(bcap_joints(cell, second));
    CHECK(on == 0 && memcmp(first, second, sizeof first) == 0);
    OK(bcap_execute(cell, "ClearError", bcap_empty(), NULL, 0, NULL));
    OK(bcap_take_arm(cell));
    OK(bcap_close(cell));
}

static void *halt_later(void *stopper) {
    wait_ms(300);
    OK(bcap_stopper_halt(*(bcap_stopper *)stopper));
    return NULL;
}

/* Halts the motion of another connection once the robot moves. */
static void *halt_motion(void *stopper) {
    bcap_controller observer = connected();
    wait_for_motion(observer);
    OK(bcap_stopper_halt(*(bcap_stopper *)stopper));
    OK(bcap_close(observer));
    return NULL;
}

static void motions(void) {
    bcap_controller cell = connected();
    STATUS(BCAP_E_ARM, bcap_move(cell, &near, 1000));
    STATUS(BCAP_E_ARM, bcap_motor(cell, true));
    STATUS(BCAP_E_NO_MOTION, bcap_wait(cell));
    OK(bcap_take_arm(cell));
    OK(bcap_motor(cell, true));
    OK(bcap_set_speed(cell, 100));
    OK(bcap_move(cell, &near, 30000));
    double joints[8];
    OK(bcap_joints(cell, joints));
    CHECK(fabs(joints[0]) < 0.01 && fabs(joints[2] - 90) < 0.01);

    /* fields that are out of range cause no motion */
    bcap_motion wrong = near;
    wrong.speed_percent = 101;
    STATUS(BCAP_E_RANGE, bcap_move(cell, &wrong, 1000));
    wrong.speed_percent = NAN;
    STATUS(BCAP_E_RANGE, bcap_move(cell, &wrong, 1000));
    wrong = near;
    wrong.pass = 70000;
    STATUS(BCAP_E_RANGE, bcap_move(cell, &wrong, 1000));
    wrong.to = NULL;
    STATUS(BCAP_E_POINTER, bcap_move(cell, &wrong, 1000));
    STATUS(BCAP_E_POINTER, bcap_move(cell, NULL, 1000));

    /* variables are read during a motion; a second motion follows the first; halt ends both */
    int64_t integer;
    const bcap_motion there = {.to = "J(20, 45, 90, 0, 45, 0)", .speed_percent = 100, .pass = BCAP_PASS_NEAR};
    OK(bcap_start(cell, &there, 30000));
    OK(bcap_start(cell, &near, 0));
    OK(bcap_read_integer(cell, "I1", &integer));
    STATUS(BCAP_E_BUSY, bcap_move(cell, &near, 1000));
    OK(bcap_wait(cell));
    OK(bcap_start(cell, &far, 60000));
    wait_for_motion(cell);
    OK(bcap_halt(cell));
    STATUS(BCAP_E_NO_MOTION, bcap_wait(cell));
    OK(bcap_give_arm(cell));
    left();

    /* a stopper ends the wait of another thread */
    OK(bcap_recover(cell, true));
    bcap_stopper stopper;
    pthread_t thread;
    OK(bcap_stopper_open(cell, &stopper));
    CHECK(pthread_create(&thread, NULL, halt_motion, &stopper) == 0);
    bcap_status ended = bcap_move(cell, &far, 60000);
    CHECK(ended == BCAP_E_HALTED);
    CHECK(pthread_join(thread, NULL) == 0);
    OK(bcap_stopper_close(stopper));
    STATUS(BCAP_E_HANDLE, bcap_stopper_halt(stopper));
    STATUS(BCAP_E_HANDLE, bcap_stopper_close(stopper));

    /* the time limit of a motion */
    OK(bcap_recover(cell, true));
    STATUS(BCAP_E_MOTION_TIMEOUT, bcap_move(cell, &far, 300));

    /* closed during a motion */
    OK(bcap_recover(cell, true));
    OK(bcap_start(cell, &far, 60000));
    wait_for_motion(cell);
    OK(bcap_close(cell));
    left();
}

static bcap_controller prepared(void) {
    bcap_controller cell = connected();
    OK(bcap_recover(cell, true));
    OK(bcap_motor(cell, true));
    OK(bcap_set_speed(cell, 100));
    OK(bcap_move(cell, &near, 30000));
    return cell;
}

/* Moves the first joint by 4 degrees and back; returns false if the stream ended before. */
static bool wave(bcap_controller cell, double *joints) {
    double actual[8];
    bcap_stream_stats stats;
    for (int cycle = 1; cycle <= 125; cycle++) {
        joints[0] = 2 * (1 - cos(cycle * 6.283185307179586 / 125));
        bcap_status status = bcap_stream_step(cell, joints, actual);
        if (status != BCAP_OK) {
            CHECK(status == BCAP_E_STREAM);
            return false;
        }
        CHECK(fabs(actual[0] - joints[0]) < 2);
    }
    if (bcap_stream_finish(cell, &stats) != BCAP_OK)
        return false;
    CHECK(stats.cycles >= 125 && stats.underflows == 0);
    return true;
}

static void streams(void) {
    const bcap_stream_options options = {.mode = 2};
    bcap_controller cell = prepared();
    double joints[8], actual[8];
    int64_t integer;
    STATUS(BCAP_E_NO_STREAM, bcap_stream_step(cell, joints, NULL));
    STATUS(BCAP_E_NO_STREAM, bcap_stream_finish(cell, NULL));
    const bcap_stream_options wrong[] = {{.mode = 3}, {.speed = -1}, {.acceleration = INFINITY}};
    for (int index = 0; index < 3; index++)
        STATUS(BCAP_E_RANGE, bcap_stream_start(cell, &wrong[index], joints));
    OK(bcap_stream_start(cell, &options, joints));
    CHECK(fabs(joints[0]) < 0.01);
    STATUS(BCAP_E_STREAMING, bcap_read_integer(cell, "I1", &integer));
    STATUS(BCAP_E_STREAMING, bcap_move(cell, &near, 1000));
    STATUS(BCAP_E_STREAMING, bcap_stream_start(cell, &options, joints));
    /* on a busy machine the controller's buffer can run empty, or a pose be late; then the stream is made again */
    for (int attempt = 1; !wave(cell, joints); attempt++) {
        CHECK(attempt < 50);
        if (!says("no pose within 100ms"))
            message("0x84201482");
        STATUS(BCAP_E_NO_STREAM, bcap_stream_finish(cell, NULL));
        OK(bcap_recover(cell, true));
        OK(bcap_move(cell, &near, 30000));
        if (is_slow && attempt == 3)
            break;
        OK(bcap_stream_start(cell, &options, joints));
    }
    OK(bcap_read_integer(cell, "I1", &integer));
    OK(bcap_joints(cell, actual));
    CHECK(fabs(actual[0]) < 0.05);

    /* a wrong pointer starts no stream, and ends one */
    STATUS(BCAP_E_POINTER, bcap_stream_start(cell, &options, NULL));
    OK(bcap_halt(cell));
    double *const misaligned = (double *)((char *)actual + 1);
    for (int index = 0; index < 2; index++) {
        OK(bcap_stream_start(cell, &options, joints));
        STATUS(BCAP_E_POINTER, bcap_stream_step(cell, index == 0 ? NULL : joints, index == 0 ? NULL : misaligned));
        STATUS(BCAP_E_NO_STREAM, bcap_stream_step(cell, joints, NULL));
        OK(bcap_recover(cell, true));
    }

    /* a pose beyond the limits is not sent, and the robot stops */
    OK(bcap_stream_start(cell, &options, joints));
    joints[0] += 45;
    STATUS(BCAP_E_STREAM, bcap_stream_step(cell, joints, NULL));
    message("Slave Mode: pose");
    STATUS(BCAP_E_NO_STREAM, bcap_stream_step(cell, joints, NULL));

    /* a program that is late, and one that closes during a stream */
    OK(bcap_recover(cell, true));
    OK(bcap_stream_start(cell, &options, joints));
    wait_ms(400);
    STATUS(BCAP_E_STREAM, bcap_stream_step(cell, joints, NULL));
    message("no pose within 100ms");
    OK(bcap_recover(cell, true));
    OK(bcap_stream_start(cell, &options, joints));
    OK(bcap_close(cell));
    left();
}

/* Halts during a stream over another connection. */
static void halted_stream(void) {
    const bcap_stream_options options = {.mode = 2};
    bcap_controller cell = prepared();
    bcap_stopper stopper;
    pthread_t thread;
    double joints[8];
    bcap_status status = BCAP_OK;
    OK(bcap_stopper_open(cell, &stopper));
    OK(bcap_stream_start(cell, &options, joints));
    CHECK(pthread_create(&thread, NULL, halt_later, &stopper) == 0);
    for (int cycle = 0; cycle < 2000 && status == BCAP_OK; cycle++) {
        joints[0] += 0.005;
        status = bcap_stream_step(cell, joints, NULL);
    }
    CHECK(status == BCAP_E_STREAM);
    CHECK(pthread_join(thread, NULL) == 0);
    OK(bcap_stopper_close(stopper));
    OK(bcap_close(cell));
    left();
}

static void misuse(void) {
    int64_t integer;
    bcap_controller cell, closed = connected(), none = {0}, wild = {UINT64_MAX};
    OK(bcap_close(closed));
    /* each handle has a new generation */
    cell = connected();
    CHECK(cell.id > closed.id);
    bcap_controller invalid[] = {closed, none, wild};
    bcap_stopper stopper = {cell.id};
    for (int index = 0; index < 3; index++) {
        STATUS(BCAP_E_HANDLE, bcap_read_integer(invalid[index], "I1", &integer));
        STATUS(BCAP_E_HANDLE, bcap_write(invalid[index], "I1", bcap_i4(1)));
        STATUS(BCAP_E_HANDLE, bcap_take_arm(invalid[index]));
        STATUS(BCAP_E_HANDLE, bcap_move(invalid[index], &near, 1));
        STATUS(BCAP_E_HANDLE, bcap_halt(invalid[index]));
        STATUS(BCAP_E_HANDLE, bcap_close(invalid[index]));
    }
    STATUS(BCAP_E_HANDLE, bcap_stopper_halt(stopper));
    STATUS(BCAP_E_HANDLE, bcap_stopper_close(stopper));
    STATUS(BCAP_E_POINTER, bcap_read_integer(cell, NULL, &integer));
    STATUS(BCAP_E_POINTER, bcap_read_integer(cell, "I1", NULL));
    STATUS(BCAP_E_POINTER, bcap_read_numbers(cell, "P1", NULL, 8, NULL));
    STATUS(BCAP_E_SHORT, bcap_read_text(cell, "S1", NULL, 10));
    STATUS(BCAP_E_POINTER, bcap_joints(cell, NULL));
    STATUS(BCAP_E_POINTER, bcap_call(cell, 1, NULL, 1, NULL, 0, NULL));
    STATUS(BCAP_E_VALUE, bcap_write(cell, "S1", bcap_text(NULL)));
    OK(bcap_close(cell));

    STATUS(BCAP_E_POINTER, bcap_connect(NULL, BCAP_RC8, &cell));
    STATUS(BCAP_E_POINTER, bcap_connect(address, BCAP_RC8, NULL));
    STATUS(BCAP_E_ADDRESS, bcap_connect("robot", BCAP_RC8, &cell));
    message("write tcp:HOST[:PORT]");
    STATUS(BCAP_E_RANGE, bcap_connect(address, 3, &cell));
    STATUS(BCAP_E_CONNECT, bcap_connect("tcp:127.0.0.1:1", BCAP_RC8, &cell));
    CHECK(cell.id == 0);
    STATUS(BCAP_E_HANDLE, bcap_close(cell));
}

static atomic_int warned, logged;

static void logger(int32_t level, const char *text, void *user) {
    CHECK(user == &warned && strlen(text) > 0 && level >= BCAP_LOG_ERROR && level <= BCAP_LOG_DEBUG);
    bcap_controller none = {0};
    CHECK(bcap_close(none) == BCAP_E_REENTRANT);
    CHECK(bcap_set_log(NULL, 0, NULL) == BCAP_E_REENTRANT);
    atomic_fetch_add(&logged, 1);
}

static void *add(void *shared) {
    bcap_controller cell = *(bcap_controller *)shared;
    for (int count = 0; count < 200; count++) {
        int64_t integer;
        OK(bcap_read_integer(cell, "I1", &integer));
        STATUS((int32_t)0x8002000b, bcap_read_integer(cell, "I99999", &integer));
        message("I99999");
    }
    return NULL;
}

static void *close_once(void *shared) {
    bcap_status status = bcap_close(*(bcap_controller *)shared);
    CHECK(status == BCAP_OK || status == BCAP_E_HANDLE);
    return status == BCAP_OK ? shared : NULL;
}

static void threads(void) {
    bcap_controller cell = connected();
    pthread_t both[2];
    void *first, *second;
    for (int index = 0; index < 2; index++)
        CHECK(pthread_create(&both[index], NULL, add, &cell) == 0);
    for (int index = 0; index < 2; index++)
        CHECK(pthread_join(both[index], NULL) == 0);
    for (int index = 0; index < 2; index++)
        CHECK(pthread_create(&both[index], NULL, close_once, &cell) == 0);
    CHECK(pthread_join(both[0], &first) == 0 && pthread_join(both[1], &second) == 0);
    CHECK((first == NULL) != (second == NULL));
}

/* Ends the program during a motion, without closing anything. */
static void leave(void) {
    bcap_controller cell = prepared();
    OK(bcap_start(cell, &far, 60000));
    wait_for_motion(cell);
    exit(0);
}

static void *read_on(void *shared) {
    int64_t integer;
    while (bcap_read_integer(*(bcap_controller *)shared, "I1", &integer) == BCAP_OK) {
    }
    return NULL;
}

/* The end of a program that only reads, while another program moves the robot. */
static void exit_as_reader(void) {
    bcap_controller cell = connected();
    pthread_t threads[4];
    wait_for_motion(cell);
    for (int index = 0; index < 4; index++)
        CHECK(pthread_create(&threads[index], NULL, read_on, &cell) == 0);
    wait_ms(100);
    exit(0);
}

static void *move_briefly(void *shared) {
    const bcap_motion there = {.to = "J(30, 45, 90, 0, 45, 0)", .speed_percent = 5};
    OK(bcap_move(*(bcap_controller *)shared, &there, 60000));
    return NULL;
}

/* Sets how many files may be open. */
static void limit_files(rlim_t count) {
    struct rlimit limit;
    CHECK(getrlimit(RLIMIT_NOFILE, &limit) == 0);
    limit.rlim_cur = count < limit.rlim_max ? count : limit.rlim_max;
    CHECK(setrlimit(RLIMIT_NOFILE, &limit) == 0);
}

/* AddressSanitizer opens files after the library has closed its controllers. */
static void allow_files(void) {
    limit_files(100);
}

/* The end of a program that cannot connect again, while another thread waits for a short motion. */
static void exit_without_connection(void) {
    bcap_controller cell = prepared(), observer = connected();
    pthread_t thread;
    CHECK(pthread_create(&thread, NULL, move_briefly, &cell) == 0);
    wait_for_motion(observer);
    limit_files(3);
    exit(0);
}

static void exit_at_signal(int number) {
    exit(number == SIGALRM ? 0 : 1);
}

/* The end of a program by the handler of a signal that interrupts a motion. */
static void exit_in_handler(void) {
    bcap_controller cell = prepared();
    signal(SIGALRM, exit_at_signal);
    alarm(1);
    bcap_move(cell, &far, 60000);
    _exit(1);
}

static void exit_at_log(int32_t level, const char *text, void *user) {
    exit(level > 0 && text != NULL && user == NULL ? 0 : 1);
}

/* The end of a program by its log callback, during a call of another controller. */
static void exit_in_callback(void) {
    int64_t integer;
    bcap_controller reader = connected();
    prepared();
    OK(bcap_set_log(exit_at_log, BCAP_LOG_DEBUG, NULL));
    bcap_read_integer(reader, "I1", &integer);
    _exit(1);
}

static bcap_controller inherited;
static bcap_stopper inherited_stopper;

/* The end of a forked process, whose handles of its parent are invalid. */
static void exit_as_child(void) {
    int64_t integer;
    STATUS(BCAP_E_HANDLE, bcap_read_integer(inherited, "I1", &integer));
    STATUS(BCAP_E_HANDLE, bcap_stopper_halt(inherited_stopper));
    STATUS(BCAP_E_HANDLE, bcap_stopper_close(inherited_stopper));
    STATUS(BCAP_E_HANDLE, bcap_close(inherited));
    OK(bcap_read_integer(connected(), "I1", &integer));
    exit(0);
}

/* Starts a program in a forked process, where the handles of this one are invalid. */
static pid_t started(void (*program)(void)) {
    pid_t child = fork();
    CHECK(child >= 0);
    if (child == 0)
        program();
    return child;
}

/* Waits until a program has ended with success. */
static void ended(pid_t child) {
    int status = -1;
    for (int waited_ms = 0; waitpid(child, &status, WNOHANG) == 0; waited_ms += 10) {
        CHECK(waited_ms < 60000 || kill(child, SIGKILL) != 0);
        wait_ms(10);
    }
    CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 0);
}

static void exits(void) {
    /* before the library's, so that it runs after it */
    CHECK(atexit(allow_files) == 0);
    pid_t reader = started(exit_as_reader);
    bcap_controller cell = prepared();
    OK(bcap_start(cell, &far, 60000));
    ended(reader);
    OK(bcap_wait(cell));
    OK(bcap_close(cell));
    ended(started(exit_without_connection));
    left();
    ended(started(exit_in_callback));
    left();
    if (!is_slow) /* otherwise the signal probably interrupts code that `exit` needs */
        ended(started(exit_in_handler));
    /* the end of a forked process does not stop the motion of its parent */
    inherited = prepared();
    OK(bcap_stopper_open(inherited, &inherited_stopper));
    OK(bcap_start(inherited, &far, 60000));
    ended(started(exit_as_child));
    if (!is_slow)
        wait_for_motion(inherited);
    OK(bcap_wait(inherited));
    OK(bcap_stopper_close(inherited_stopper));
    OK(bcap_close(inherited));
    cell = prepared();
    OK(bcap_close(cell));
}

int main(int argc, char **argv) {
    CHECK(argc > 1);
    address = argv[1];
    if (argc > 2 && strcmp(argv[2], "leave") == 0)
        leave();
    if (argc > 2 && strcmp(argv[2], "left") == 0) {
        left();
        return 0;
    }
    is_slow = argc > 2 && strcmp(argv[2], "slow") == 0;
    exits();
    OK(bcap_set_log(logger, BCAP_LOG_DEBUG, &warned));
    variables();
    misuse();
    threads();
    motions();
    streams();
    halted_stream();
    OK(bcap_set_log(NULL, 0, NULL));
    printf("hosted: ok, %d log messages\n", atomic_load(&logged));
    return 0;
}
