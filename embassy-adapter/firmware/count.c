/*
 * A TCG plugin of QEMU that counts the instructions of the emulated processor.
 *
 *     run --count FILE ...     or     qemu-system-arm ... -plugin libcount.so,out=FILE[,profile=PROFILE]
 *
 * FILE has the count as 8 bytes, little-endian on the hosts that run it, and is mapped into memory, so another process reads it at
 * any time. A processor that waits for an interrupt executes no instruction.
 *
 * With PROFILE, a second word of 8 bytes in FILE starts the profile with 1. With 0 the profile is written, in the format of callgrind
 * with mangled names. The processor has no stack of calls that a plugin sees, so it is guessed: a function that is executed after another
 * is its callee, unless it is further up in the stack and was returned to. An interrupt looks like a call. Functions that call each
 * other look like one call.
 *
 * The declarations are those of QEMU's documentation (docs/devel/tcg-plugins.rst, version 1 of the interface), because Debian has no
 * package with qemu-plugin.h.
 */
#include <fcntl.h>
#include <inttypes.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

typedef uint64_t qemu_plugin_id_t;
struct qemu_plugin_tb;
struct qemu_plugin_insn;
typedef struct qemu_info_t qemu_info_t;
enum qemu_plugin_op { QEMU_PLUGIN_INLINE_ADD_U64 };
enum qemu_plugin_cb_flags { QEMU_PLUGIN_CB_NO_REGS };
typedef void (*qemu_plugin_vcpu_tb_trans_cb_t)(qemu_plugin_id_t id, struct qemu_plugin_tb *tb);
typedef void (*qemu_plugin_vcpu_udata_cb_t)(unsigned int cpu, void *data);

void qemu_plugin_register_vcpu_tb_trans_cb(qemu_plugin_id_t id, qemu_plugin_vcpu_tb_trans_cb_t callback);
void qemu_plugin_register_vcpu_tb_exec_inline(struct qemu_plugin_tb *tb, enum qemu_plugin_op op, void *pointer, uint64_t value);
void qemu_plugin_register_vcpu_tb_exec_cb(struct qemu_plugin_tb *tb, qemu_plugin_vcpu_udata_cb_t callback,
                                          enum qemu_plugin_cb_flags flags, void *data);
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *tb);
struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *tb, size_t index);
const char *qemu_plugin_insn_symbol(const struct qemu_plugin_insn *insn);

#define EXPORT __attribute__((visibility("default")))
#define FUNCTIONS 2048
#define DEEPEST 256

EXPORT int qemu_plugin_version = 1;

/* The file: the count, and whether a profile is recorded. */
static volatile uint64_t *shared;
static const char *profile;

static const char *names[FUNCTIONS];
static uint64_t own[FUNCTIONS];
static uint64_t calls[FUNCTIONS][FUNCTIONS];
static unsigned functions;

/* The guessed stack: functions, and the count when each was called. */
static struct { unsigned function; uint64_t since; } stack[DEEPEST];
static unsigned depth;
static bool recording;

/* A block of code, in memory that is never freed. */
struct block {
    unsigned function;
    uint64_t instructions;
};

static void pop(void)
{
    depth--;
    if (recording && depth > 0)
        calls[stack[depth - 1].function][stack[depth].function] += shared[0] - stack[depth].since;
}

static void write_profile(void)
{
    FILE *out = fopen(profile, "w");
    if (out == NULL) {
        perror("count: cannot create the profile");
        return;
    }
    for (unsigned caller = 0; caller < functions; caller++) {
        fprintf(out, "fn=(%u) %s\n0 %" PRIu64 "\n", caller, names[caller], own[caller]);
        for (unsigned callee = 0; callee < functions; callee++)
            if (calls[caller][callee] > 0)
                fprintf(out, "cfn=(%u) %s\ncalls=1 0\n0 %" PRIu64 "\n", callee, names[callee], calls[caller][callee]);
    }
    fclose(out);
}

static void enter(unsigned function)
{
    unsigned at = depth;
    while (at > 0 && stack[at - 1].function != function)
        at--;
    if (at > 0) {
        while (depth > at)
            pop();
    } else if (depth < DEEPEST) {
        stack[depth].function = function;
        stack[depth].since = shared[0];
        depth++;
    }
}

static void executed(unsigned int cpu, void *data)
{
    const struct block *block = data;
    (void)cpu;
    if (shared[1] == 0 && recording) {
        while (depth > 0)
            pop();
        recording = false;
        write_profile();
    } else if (shared[1] != 0 && !recording) {
        recording = true;
        for (unsigned at = 0; at < depth; at++)
            stack[at].since = shared[0];
    }
    // also while nothing is recorded: the stack of a profile begins with the first function of the program
    enter(block->function);
    if (recording)
        own[block->function] += block->instructions;
    shared[0] += block->instructions;
}

static unsigned function_of(const struct qemu_plugin_tb *tb)
{
    const char *name = qemu_plugin_insn_symbol(qemu_plugin_tb_get_insn(tb, 0));
    if (name == NULL)
        name = "unknown";
    for (unsigned function = 0; function < functions; function++)
        if (strcmp(names[function], name) == 0)
            return function;
    if (functions == FUNCTIONS) {
        fprintf(stderr, "count: more than %d functions\n", FUNCTIONS);
        exit(1);
    }
    names[functions] = strdup(name);
    return functions++;
}

static void translated(qemu_plugin_id_t id, struct qemu_plugin_tb *tb)
{
    size_t instructions = qemu_plugin_tb_n_insns(tb);
    (void)id;
    if (profile == NULL) {
        qemu_plugin_register_vcpu_tb_exec_inline(tb, QEMU_PLUGIN_INLINE_ADD_U64, (void *)shared, instructions);
        return;
    }
    struct block *block = malloc(sizeof *block);
    if (block == NULL)
        abort();
    *block = (struct block){ function_of(tb), instructions };
    qemu_plugin_register_vcpu_tb_exec_cb(tb, executed, QEMU_PLUGIN_CB_NO_REGS, block);
}

EXPORT int qemu_plugin_install(qemu_plugin_id_t id, const qemu_info_t *info, int argc, char **argv)
{
    (void)info;
    if (argc < 1 || argc > 2 || strncmp(argv[0], "out=", 4) != 0 || (argc == 2 && strncmp(argv[1], "profile=", 8) != 0)) {
        fprintf(stderr, "count: expected out=FILE[,profile=PROFILE]\n");
        return -1;
    }
    if (argc == 2)
        profile = strdup(argv[1] + 8);
    int file = open(argv[0] + 4, O_RDWR | O_CREAT | O_TRUNC, 0600);
    if (file < 0 || ftruncate(file, 2 * sizeof *shared) != 0) {
        perror("count: cannot create the file");
        return -1;
    }
    shared = mmap(NULL, 2 * sizeof *shared, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    close(file);
    if (shared == MAP_FAILED) {
        perror("count: cannot map the file");
        return -1;
    }
    qemu_plugin_register_vcpu_tb_trans_cb(id, translated);
    return 0;
}
