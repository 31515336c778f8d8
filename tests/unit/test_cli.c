/* The tools' skin, run in child processes as the tools run it. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "cli.h"
#include "fmt_file.h"
#include "fmti_cleanup.h"
#include "test.h"

/* --- a tool that prints what it was given --- */

static uint64_t depth = 8, cache = (uint64_t)1536 << 20;
static double tolerance = 0.5, eye[3] = {0, 1, 2};
static bool lod, depth_seen, eye_seen;
static int mode = 1;
static const char *text;
static const char *const modes[] = {"svdag", "symmetric", "fast", NULL};
static const cli_option options[] = {
    {.name = "depth", .letter = 'd', .kind = CLI_U64, .value = &depth, .argument = "D", .help = "Depth.", .max = 21, .seen = &depth_seen},
    {.name = "tolerance", .kind = CLI_DOUBLE, .value = &tolerance, .argument = "X", .help = "Tolerance.", .max = INFINITY},
    {.name = "eye", .kind = CLI_VEC3, .value = eye, .argument = "x,y,z", .help = "Eye.", .seen = &eye_seen, .no_default = true, .group = "Camera"},
    {.name = "mode", .kind = CLI_CHOICE, .value = &mode, .argument = "MODE", .help = "Mode.", .choices = modes},
    {.name = "text", .kind = CLI_TEXT, .value = &text, .argument = "T", .help = "Text.", .no_default = true},
    {.name = "cache", .kind = CLI_SIZE, .value = &cache, .argument = "SIZE", .help = "Cache.", .min = 1, .max = 0x1p40},
    {.name = "lod", .letter = 'l', .kind = CLI_FLAG, .value = &lod, .help = "Detail."},
};
static const cli_tool tool = {.name = "svo-test", .summary = "try the skin", .synopsis = "IN... -o OUT", .options = options,
                              .option_count = sizeof options / sizeof *options, .details = "Details.", .example = "svo-test a -o b",
                              .min_inputs = 1, .max_inputs = 3, .has_output = true};

static int tool_main(int argc, char **argv)
{
    cli c;
    int code = cli_begin(&c, &tool, argc, argv);
    if (code >= 0) return code;
    printf("depth=%llu%s tolerance=%g eye=%g,%g,%g%s mode=%s text=%s cache=%llu lod=%d out=%s threads=%llu memory=%llu verbose=%d quiet=%d in=",
           (unsigned long long)depth, depth_seen ? "!" : "", tolerance, eye[0], eye[1], eye[2], eye_seen ? "!" : "", modes[mode],
           text ? text : "-", (unsigned long long)cache, lod, c.output, (unsigned long long)c.threads, (unsigned long long)c.memory, c.verbose, c.quiet);
    for (int i = 0; i < c.input_count; i++) printf("[%s]", c.inputs[i]);
    printf("\n");
    cli_phase(&c, "first");
    cli_phase(&c, "second");
    cli_phase(&c, "first");
    cli_info(&c, "info");
    cli_verbose(&c, "detail");
    svo_warn(&c.warnings, "careful");
    svo_warn(&c.warnings, "careful");
    cli_put_f64(cli_section(&c, "errors"), "infinite", INFINITY);
    cli_put_f64(cli_section(&c, "errors"), "third", 1.0 / 3);
    cli_put_text(cli_section(&c, "input"), "name", "bad\xff\xc0\x80 good\xc3\xa9");
    cli_put_u64(cli_section(&c, "output"), "bytes", UINT64_MAX);
    svo_error err = {0};
    if (text != NULL && strcmp(text, "usage") == 0) return cli_usage(&c, "this does not go with %s", "that");
    if (text != NULL && strcmp(text, "differs") == 0) return cli_end_code(&c, 7);
    if (text != NULL && strcmp(text, "wait") == 0) raise(SIGSTOP);
    if (text != NULL && strcmp(text, "fail") == 0) {
        svo_fail(&err, SVO_INVALID_DATA, "x.svo: bad chunk");
        err.chunk = 'T' | 'R' << 8 | 'E' << 16 | 'E' << 24, err.offset = 4096;
    }
    return cli_end(&c, err.code, &err);
}

static struct { int code; char out[8192], err[8192]; } ran;

static void read_back(int fd, char *to, size_t size)
{
    ssize_t n = pread(fd, to, size - 1, 0);
    to[n > 0 ? n : 0] = 0;
    close(fd);
}

/* Run with a command line split at blanks; stdout may be replaced. */
static void run_to(const char *line, const char *stdout_path)
{
    static char words[2048];
    char *argv[64] = {(char *)"svo-test"};
    int argc = 1;
    snprintf(words, sizeof words, "%s", line);
    for (char *w = strtok(words, " "); w != NULL; w = strtok(NULL, " ")) argv[argc++] = strcmp(w, "''") == 0 ? (char *)"" : w;
    int out = memfd_create("out", 0), err = memfd_create("err", 0);
    fflush(NULL);
    const char *folder = test_folder(); /* before the fork: a child's own would not be removed */
    pid_t child = fork();
    if (child == 0) {
        if (chdir(folder) != 0) _exit(99);
        dup2(stdout_path != NULL ? open(stdout_path, O_WRONLY) : out, 1);
        dup2(err, 2);
        int code = tool_main(argc, argv);
        fflush(NULL);
        _exit(code);
    }
    int status;
    waitpid(child, &status, 0);
    ran.code = WIFEXITED(status) ? WEXITSTATUS(status) : 1000 + WTERMSIG(status);
    read_back(out, ran.out, sizeof ran.out);
    read_back(err, ran.err, sizeof ran.err);
}

static void run(const char *line) { run_to(line, NULL); }

#define EXPECT_OUT(part) CHECK_MSG(strstr(ran.out, part) != NULL, "no '%s' in: %s (stderr: %s)", part, ran.out, ran.err)
#define EXPECT_ERR(part) CHECK_MSG(strstr(ran.err, part) != NULL, "no '%s' in: %s", part, ran.err)

static const char *in_folder(const char *name)
{
    static char path[4][300];
    static int turn;
    turn = (turn + 1) % 4;
    snprintf(path[turn], sizeof path[turn], "%s/%s", test_folder(), name);
    return path[turn];
}

static void write_file(const char *name, const char *content)
{
    FILE *f = fopen(in_folder(name), "w");
    fputs(content, f);
    fclose(f);
}

static bool file_is(const char *name, const char *content)
{
    char got[4096] = {0};
    FILE *f = fopen(in_folder(name), "r");
    if (f == NULL) return false;
    size_t n = fread(got, 1, sizeof got - 1, f);
    fclose(f);
    return n == strlen(content) && strcmp(got, content) == 0;
}

/* --- parsing --- */

TEST(options_in_all_their_forms)
{
    run("a -o b");
    CHECK(ran.code == 0);
    EXPECT_OUT("depth=8 tolerance=0.5 eye=0,1,2 mode=symmetric text=- cache=1610612736 lod=0 out=b threads=0 memory=0 verbose=0 quiet=0 in=[a]");
    run("--depth 21 a --output=b --tolerance=1e-3 --eye -1,.5,3e2 --mode fast --cache 64K --lod --threads 7 --memory 2G -v -v - c");
    CHECK_MSG(ran.code == 0, "exit %d: %s", ran.code, ran.err);
    EXPECT_OUT("depth=21! tolerance=0.001 eye=-1,0.5,300! mode=fast text=- cache=65536 lod=1 out=b threads=7 memory=2147483648 verbose=2 quiet=0 in=[a][-][c]");
    run("-d3 -lqob a --text=--strange");
    CHECK(ran.code == 0);
    EXPECT_OUT("depth=3! ");
    EXPECT_OUT("text=--strange cache=1610612736 lod=1 out=b threads=0 memory=0 verbose=0 quiet=1");
    run("-o b -- --depth -x -");
    CHECK(ran.code == 0);
    EXPECT_OUT("in=[--depth][-x][-]");
    run("a -o - -d 1 -d 2");
    EXPECT_OUT("depth=2! ");
}

TEST(sizes)
{
    static const struct { const char *text, *bytes; } good[] = {{"1", "1"}, {"1000", "1000"}, {"1000B", "1000"}, {"2K", "2048"}, {"2k", "2048"},
        {"2KiB", "2048"}, {"3M", "3145728"}, {"1.5G", "1610612736"}, {"1T", "1099511627776"}, {"0.25M", "262144"}};
    for (size_t i = 0; i < sizeof good / sizeof *good; i++) {
        char line[100], want[100];
        snprintf(line, sizeof line, "a -o b --cache %s", good[i].text);
        snprintf(want, sizeof want, "cache=%s ", good[i].bytes);
        run(line);
        EXPECT_OUT(want);
    }
    static const char *const bad[] = {"0", "2T", "-1", "K", "1.5", "1KB", "1Ki", "1X", "1 K", "0x10", "99999999999999999999", "9999999T", "1.", "1.K", "''"};
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        char line[100];
        snprintf(line, sizeof line, "a -o b --cache=%s", strcmp(bad[i], "''") == 0 ? "" : bad[i]);
        run(line);
        if (strcmp(bad[i], "1 K") == 0) continue; /* split into an input here */
        CHECK_MSG(ran.code == 1, "--cache %s: exit %d", bad[i], ran.code);
    }
}

TEST(wrong_command_lines_are_refused_in_one_line)
{
    static const struct { const char *line, *word; } bad[] = {
        {"", "no input"}, {"a", "no output"}, {"a b c d -o x", "'d'"}, {"--foo a -o b", "--foo"}, {"--dept 3 a -o b", "--dept"},
        {"-x a -o b", "-x"}, {"-lx a -o b", "'-x'"}, {"a -o b --depth", "--depth needs a value"}, {"a -o b -d 22", "0..21"}, {"a -o b -d -1", "'-1'"},
        {"a -o b -d 1.5", "whole number"}, {"a -o b -d 1x", "1x"}, {"a -o b -d ''", "''"}, {"a -o b --depth=", "whole number"}, {"a -o b -d 0x3", "0x3"},
        {"a -o b -d 99999999999999999999999", "whole number"}, {"a -o b --tolerance nan", "nan"}, {"a -o b --tolerance inf", "inf"},
        {"a -o b --tolerance 1e999", "1e999"}, {"a -o b --tolerance -1", "0 or more"}, {"a -o b --tolerance 1,5", "1,5"}, {"a -o b --tolerance 0x1p3", "0x1p3"},
        {"a -o b --eye 1,2", "x,y,z"}, {"a -o b --eye 1,2,3,4", "x,y,z"}, {"a -o b --eye 1,,3", "x,y,z"}, {"a -o b --eye 1,2,nan", "x,y,z"},
        {"a -o b --mode slow", "svdag|symmetric|fast"}, {"a -o b --mode FAST", "FAST"}, {"a -o b --lod=yes", "takes no value"},
        {"a -o b --text --lod", "--text needs a value"}, {"a -o ''", "empty"}, {"'' -o b", "empty"}, {"a -o a", "overwrite"}, {"a -o ./a", "overwrite"},
        {"a -o b --report a", "overwrite"}, {"a -o b --report b", "same file"}, {"a -o - --report -", "same file"}, {"- - -o b", "stdin"},
        {"a -o b --threads 1025", "0..1024"}, {"a -o b --memory lots", "lots"}, {"a -o b --text usage", "does not go with that"}};
    write_file("a", "input");
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        run(bad[i].line);
        CHECK_MSG(ran.code == 1, "'%s': exit %d: %s", bad[i].line, ran.code, ran.err);
        EXPECT_ERR(bad[i].word);
        EXPECT_ERR("see svo-test --help\n");
        const char *last = strrchr(ran.err, '\n');
        bool said_more = strstr(bad[i].line, "usage") != NULL; /* this one had begun to talk */
        CHECK_MSG(strncmp(ran.err, "svo-test: ", 10) == 0 && last[1] == 0 && (said_more || strchr(ran.err, '\n') == last), "'%s': %s", bad[i].line, ran.err);
        CHECK(said_more || ran.out[0] == 0);
    }
    CHECK(file_is("a", "input"));
}

TEST(help_and_version_come_from_the_table)
{
    run("--version");
    CHECK(ran.code == 0 && strcmp(ran.out, "svo-test " SVO_VERSION_STRING " (svokit)\n") == 0 && ran.err[0] == 0);
    static const char *const ways[] = {"--help", "-h", "a --bogus -h", "-d 99 --help"};
    for (size_t w = 0; w < 4; w++) {
        run(ways[w]);
        CHECK_MSG(ran.code == 0 && ran.err[0] == 0, "%s: exit %d %s", ways[w], ran.code, ran.err);
        for (size_t i = 0; i < tool.option_count; i++) EXPECT_OUT(options[i].name);
        static const char *const parts[] = {"svo-test: try the skin", "Usage: svo-test IN... -o OUT", "-d, --depth D", "(0..21; default 8)",
            "(0 or more; default 0.5)", "(svdag|symmetric|fast; default symmetric)", "(1..1T; default 1536M)", "\nCamera:\n", "-o, --output OUT",
            "-f, --force", "--threads N", "--memory SIZE", "--report R.json", "-q, --quiet", "-v, --verbose", "--no-progress", "-h, --help",
            "--version", "Details.", "svo-test a -o b", "Exit status:", "  0  ok", "  2  input/output error", "  3  invalid input",
            "out of memory", "  5  unsupported", "  6  over a stated limit", "  7  "};
        for (size_t i = 0; i < sizeof parts / sizeof *parts; i++) EXPECT_OUT(parts[i]);
        for (const char *p = ran.out; p != NULL && *p != 0;) { /* readable in 100 columns */
            const char *end = strchr(p, '\n');
            CHECK(end != NULL && end - p <= 100);
            p = end + 1;
        }
    }
    run_to("--help", "/dev/full");
    CHECK(ran.code == 2);
}

/* --- talk and report --- */

TEST(talk_goes_to_stderr)
{
    run("a -o b");
    CHECK(strcmp(ran.err, "svo-test: info\nsvo-test: warning: careful (2 times)\n") == 0);
    run("a -o b -v");
    EXPECT_ERR("svo-test: detail\n");
    run("a -o b -q -v");
    CHECK(ran.err[0] == 0);
    run("a -o b -q --text fail");
    CHECK(ran.code == 3 && strcmp(ran.err, "svo-test: error: x.svo: bad chunk\n") == 0);
    run("a -o b --text differs");
    CHECK(ran.code == 7);
    run_to("a -o b", "/dev/full");
    CHECK(ran.code == 2);
    EXPECT_ERR("stdout could not be written");
}

static json_t *load_report(const char *name)
{
    return json_load_file(in_folder(name), JSON_REJECT_DUPLICATES, NULL);
}

TEST(report_has_its_keys)
{
    run("a -o b --report r1.json --depth 9");
    CHECK(ran.code == 0);
    json_t *r = load_report("r1.json");
    CHECK(r != NULL);
    const char *tool_name, *version, *mode_name;
    int exit_code, d;
    double wall, third;
    json_int_t rss;
    json_t *infinite, *warnings, *phases, *missing_text, *eye_value;
    CHECK(json_unpack(r, "{s:s,s:s,s:i,s:F,s:I,s:{s:i,s:s,s:o,s:o},s:{s:o,s:F},s:o,s:o}", "tool", &tool_name, "version", &version, "exit_code", &exit_code,
                      "wall_seconds", &wall, "peak_rss_bytes", &rss, "options", "depth", &d, "mode", &mode_name, "text", &missing_text, "eye", &eye_value,
                      "errors", "infinite", &infinite, "third", &third, "warnings", &warnings, "phases", &phases) == 0);
    CHECK(strcmp(tool_name, "svo-test") == 0 && strcmp(version, SVO_VERSION_STRING) == 0 && exit_code == 0 && wall >= 0 && rss > 100000);
    CHECK(d == 9 && strcmp(mode_name, "symmetric") == 0 && json_is_null(missing_text) && json_is_null(eye_value));
    CHECK(json_is_null(infinite) && third == 1.0 / 3);
    CHECK(json_array_size(warnings) == 1 && strcmp(json_string_value(json_array_get(warnings, 0)), "careful (2 times)") == 0);
    CHECK(json_array_size(phases) == 2 && strcmp(json_string_value(json_object_get(json_array_get(phases, 1), "name")), "second") == 0);
    CHECK(strcmp(json_string_value(json_object_get(json_object_get(r, "input"), "name")), "bad\xef\xbf\xbd\xef\xbf\xbd\xef\xbf\xbd good\xc3\xa9") == 0);
    CHECK(json_object_get(r, "error") == NULL && json_is_object(json_object_get(r, "output")));
    json_decref(r);
    run("a -o b --report r2.json --text fail");
    CHECK(ran.code == 3);
    r = load_report("r2.json");
    const char *message, *code_name, *chunk;
    int offset;
    CHECK(json_unpack(r, "{s:s,s:s,s:i,s:{s:s,s:i}}", "error", &message, "error_code", &code_name, "exit_code", &exit_code, "error_place", "chunk", &chunk,
                      "offset", &offset) == 0);
    CHECK(strcmp(message, "x.svo: bad chunk") == 0 && strcmp(code_name, "INVALID_DATA") == 0 && exit_code == 3 && strcmp(chunk, "TREE") == 0 && offset == 4096);
    json_decref(r);
    run("a -o b --report r3.json --text usage");
    CHECK(ran.code == 1);
    r = load_report("r3.json");
    CHECK(json_integer_value(json_object_get(r, "exit_code")) == 1 && json_object_get(r, "error") != NULL);
    json_decref(r);
    run("a -o b -q --report -");
    CHECK(ran.code == 0);
    EXPECT_OUT("\"tool\": \"svo-test\"");
}

TEST(a_report_replaces_a_report_only)
{
    run("a -o b --report again.json");
    CHECK(ran.code == 0);
    run("a -o b --report again.json --depth 5");
    CHECK(ran.code == 0);
    json_t *r = load_report("again.json");
    CHECK(json_integer_value(json_object_get(json_object_get(r, "options"), "depth")) == 5);
    json_decref(r);
    static const char *const others[] = {"precious", "{}", "{\"tool\":\"hammer\",\"wall_seconds\":1}", "[1]"};
    for (size_t i = 0; i < 4; i++) {
        write_file("other.json", others[i]);
        run("a -o b --report other.json");
        CHECK(ran.code == 2 && ran.out[0] == 0);
        CHECK(file_is("other.json", others[i]));
    }
    run("a -o b --report other.json --force");
    CHECK(ran.code == 0 && !file_is("other.json", "[1]"));
    run("a -o b --report missing-folder/r.json");
    CHECK(ran.code == 2 && ran.out[0] == 0); /* before any work */
}

TEST(provenance_is_stable_and_has_no_paths)
{
    cli c = {.tool = &tool};
    json_t *inputs = json_array();
    json_array_append_new(inputs, cli_provenance_input("/home/someone/models/cow.obj", "0123"));
    char *made = cli_provenance(&c, json_pack("{s:i,s:b}", "z", 1, "a", 1), inputs);
    CHECK(strcmp(made, "{\"inputs\":[{\"hash\":\"0123\",\"name\":\"cow.obj\"}],\"options\":{\"a\":true,\"z\":1},\"tool\":\"svo-test\",\"version\":\"" SVO_VERSION_STRING "\"}") == 0);
    free(made);
    made = cli_provenance(&c, NULL, NULL);
    CHECK(strstr(made, "\"options\":{}") != NULL);
    free(made);
}

/* --- interruption --- */

static int entries(const char *folder)
{
    char command[400];
    snprintf(command, sizeof command, "ls -A '%s' | wc -l", folder);
    FILE *p = popen(command, "r");
    int n = -1;
    if (fscanf(p, "%d", &n) != 1) n = -1;
    pclose(p);
    return n;
}

TEST(an_interrupted_run_leaves_nothing)
{
    static const int signals[] = {SIGINT, SIGTERM, SIGHUP, SIGKILL};
    char folder[300];
    snprintf(folder, sizeof folder, "%s/interrupted", test_folder());
    CHECK(mkdir(folder, 0700) == 0);
    for (size_t i = 0; i < 4; i++) {
        fflush(NULL);
        pid_t child = fork();
        if (child == 0) {
            char out[400], report[400], *argv[] = {(char *)"svo-test", (char *)"a", (char *)"-o", out, (char *)"--report", report};
            snprintf(out, sizeof out, "%s/out", folder);
            snprintf(report, sizeof report, "%s/r.json", folder);
            cli c;
            fmt_output *o;
            svo_error err = {0};
            if (cli_begin(&c, &tool, 6, argv) >= 0) _exit(90);
            if (fmt_output_open(out, false, &o, &err) != SVO_OK) _exit(91);
            for (int k = 0; k < 1000; k++)
                if (fmt_output_write(o, folder, sizeof folder, &err) != SVO_OK) _exit(92);
            /* what an output does on a file system that has no unnamed files */
            static char named[400];
            snprintf(named, sizeof named, "%s/out.part", folder);
            if (signals[i] != SIGKILL) {
                close(open(named, O_CREAT | O_WRONLY, 0600));
                fmti_temporary_remember(named);
            }
            raise(signals[i]);
            _exit(93);
        }
        int status;
        waitpid(child, &status, 0);
        CHECK_MSG(WIFSIGNALED(status) && WTERMSIG(status) == signals[i], "signal %d: status %x", signals[i], (unsigned)status);
        CHECK_MSG(entries(folder) == 0, "signal %d: %d files left", signals[i], entries(folder));
    }
}

TEST(a_reader_that_goes_away_is_an_error_not_a_signal)
{
    int ends[2];
    CHECK(pipe(ends) == 0);
    close(ends[0]);
    fflush(NULL);
    pid_t child = fork();
    if (child == 0) {
        dup2(ends[1], 1);
        close(2);
        char *argv[] = {(char *)"svo-test", (char *)"a", (char *)"-o", (char *)"b"};
        _exit(tool_main(4, argv));
    }
    close(ends[1]);
    int status;
    waitpid(child, &status, 0);
    CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 2);
}
