/* A hand in C with libzmq and msgpack-c, from proto/ alone: it goes where haptic/command says, obeys a stop, and gives one
   of its own after STOP_AFTER_S; 0 for none. From `start` on it presses by straight lines between the points TIME_S:FORCE_N.
   tcp:// is CURVE, with the key file $HAND_KEY_FILE, and $RIG_KEY as the one public key of the rig's machine. */
#include <fnmatch.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>
#include <zmq.h>
#include "maps.h"
#define NODE "haptic_node@master"
#define OWN_STOP "c-stop-1"
#define MS 1000000LL
enum { STATE, EVENT, HEALTH, CONTROL };
static const char *topics[] = {"haptic/state", "session/event", "node/health", "session/control"}, *done_texts[64];
static int64_t sent[4], run, offset_ns, answered_seq, answered_ns, answered_at_ns, stop_ns, started_ns;
static double position[3], force[3], tip[3], still[3], rate_hz;
static char latch[65], mode[65] = "off", done_ids[64][65], public_key[41], secret_key[41], *rig_key, **points;
static int is_latched, is_armed, is_given, done;
static void *publisher, *reader, *zap;
static int64_t clock_ns(clockid_t id) { struct timespec now; clock_gettime(id, &now); return now.tv_sec * 1000 * MS + now.tv_nsec; }
static int64_t now_ns(void) { return offset_ns + clock_ns(CLOCK_MONOTONIC); }
static void begin(int topic, int keys) {
  msgpack_sbuffer_clear(&buffer); msgpack_pack_map(&packer, keys + 5); fields("seq:i t_ns:i v:i run:i src:s", sent[topic]++, now_ns(), 1LL, run, topic == CONTROL ? "estop@master" : NODE);
}
static void end(int topic) { zmq_send(publisher, topics[topic], strlen(topics[topic]), ZMQ_SNDMORE); zmq_send(publisher, buffer.data, buffer.size, 0); }
static void answer(const Object *map, const char *id, const char *why, int is_expired) { /* an empty reason acknowledges */
  char command[65], target[65], giver[65]; const char *kind = *why ? "refused" : "ack", *level = *why ? "warning" : "info";
  begin(EVENT, 5); fields("id:s kind:s level:s text:s data:m", id, kind, level, why, 4 + is_expired + (*latch ? 3 : 0));
  fields("command:s target:s", word(at(map, "command"), command), word(at(map, "target"), target)); fields("giver:s sent_t_ns:i", word(at(map, "src"), giver), whole(at(map, "t_ns"))); if (is_expired) fields("expired:b", 1);
  if (*latch) { fields("latch:s latched:b estop_age_s:d", latch, is_latched, 1e-9 * (now_ns() - stop_ns)); } end(EVENT);
}
static void stop(const char *id) { is_latched = 1; is_armed = 0; stop_ns = now_ns(); strcpy(latch, id); }
static void control(const Object *map) {
  char id[65], command[65], target[65], quoted[65]; const char *why = "", *optional[] = {"run", "validity_s", "node_t_ns", "node_latch", "by"};
  word(at(map, "id"), id); word(at(map, "command"), command); word(at(map, "target"), target); uint32_t keys = 8;
  int is_named = !strcmp(target, NODE) || !strcmp(target, "haptic_node"), is_stop = !strcmp(command, "estop") || !strcmp(command, "stop");
  if (!*id || !at(map, "parameters") || (!is_named && fnmatch(target, NODE, 0))) return;
  for (int each = 0; each < 64 && each < done; each++) if (!strcmp(done_ids[each], id)) { answer(map, id, done_texts[each], 0); return; }
  int64_t told = whole(at(at(map, "node_t_ns"), NODE)), age = now_ns() - (told < 0 ? whole(at(map, "t_ns")) : told);
  double valid_s = number(at(map, "validity_s")); for (int each = 0; each < 5; each++) keys += at(map, optional[each]) != NULL;
  int is_void = !is_stop && (age > 1e9 * (valid_s < 0 ? 1 : valid_s) || age < -100 * MS), is_arm = !strcmp(command, "arm");
  int is_quoted = !*latch || !strcmp(word(at(at(map, "node_latch"), NODE), quoted), latch);
  why = is_void ? "the command has expired" : map->via.map.size != keys ? "it has a key that is not known" : is_arm && !is_quoted ? "it was stopped since: quote that stop" : "";
  if (*why) { answer(map, id, why, is_void); return; }
  if (is_arm) is_armed = 1, is_latched = 0;
  else if (!strcmp(command, "estop")) stop(id);
  else if (is_stop || !strcmp(command, "start")) started_ns = is_stop ? 0 : now_ns(); else { why = "this hand does not know the command"; if (!is_named) return; }
  strcpy(done_ids[done % 64], id); done_texts[done++ % 64] = why; answer(map, id, why, 0);
}
static void take(const char *topic, const Object *map) {
  char id[65], kind[65]; if (whole(at(map, "v")) != 1 || whole(at(map, "seq")) < 0) return;
  if (!strcmp(topic, "session/control")) control(map);
  if (!strcmp(topic, "session/event") && !strcmp(word(at(map, "id"), id), OWN_STOP)) is_given |= !strcmp(word(at(map, "kind"), kind), "ack"); else if (!strcmp(topic, "afm/state")) vector(at(map, "tip_force_n"), tip);
  if (strcmp(topic, "haptic/command") || is_latched) return;
  answered_seq = whole(at(map, "hand_seq")); answered_ns = whole(at(map, "hand_t_ns")); answered_at_ns = now_ns();
  vector(at(map, "position_m"), position); vector(at(map, "force_n"), force); word(at(map, "mode"), mode);
}
static int has_more(void *socket) { int more; size_t length = sizeof more; return !zmq_getsockopt(socket, ZMQ_RCVMORE, &more, &length) && more; }
static void read_all(void) {
  char topic[65]; static char payload[1 << 20]; int size, bytes = 0, frames; msgpack_unpacked message;
  while ((size = zmq_recv(reader, topic, 64, ZMQ_DONTWAIT)) >= 0) {
    topic[size < 64 ? size : 64] = 0; msgpack_unpacked_init(&message);
    for (frames = 1; has_more(reader); frames++) { bytes = zmq_recv(reader, payload, sizeof payload, 0); }
    int is_whole = frames == 2 && bytes <= (int)sizeof payload && msgpack_unpack_next(&message, payload, bytes, NULL) == MSGPACK_UNPACK_SUCCESS;
    if (is_whole) { take(topic, &message.data); } msgpack_unpacked_destroy(&message);
  }
}
static void admit(void) { /* ZAP: the rig's key and its own are let in */
  char parts[8][65], key[41]; int sizes[8], count;
  while ((sizes[0] = zmq_recv(zap, parts[0], 64, ZMQ_DONTWAIT)) >= 0) {
    for (count = 1; has_more(zap); count++) sizes[count % 8] = zmq_recv(zap, parts[count % 8], 64, 0);
    int is_key = count == 7 && sizes[6] == 32 && zmq_z85_encode(key, (uint8_t *)parts[6], 32);
    const char *code = is_key && (!strcmp(key, rig_key) || !strcmp(key, public_key)) ? "200" : "400";
    zmq_send(zap, "1.0", 3, ZMQ_SNDMORE); zmq_send(zap, parts[1], sizes[1] < 64 ? sizes[1] : 64, ZMQ_SNDMORE); zmq_send(zap, code, 3, ZMQ_SNDMORE);
    for (int each = 2; each >= 0; each--) zmq_send(zap, "", 0, each ? ZMQ_SNDMORE : 0);
  }
}
static void secure(void *socket, const char *endpoint, int is_server) {
  if (!strncmp(endpoint, "tcp:", 4)) zmq_setsockopt(socket, ZMQ_CURVE_SECRETKEY, secret_key, 41); else return;
  if (is_server) zmq_setsockopt(socket, ZMQ_CURVE_SERVER, &(int){1}, sizeof(int));
  else zmq_setsockopt(socket, ZMQ_CURVE_PUBLICKEY, public_key, 41), zmq_setsockopt(socket, ZMQ_CURVE_SERVERKEY, rig_key, 41);
}
static double pressed_n(double at_s) { double before_s = 0, before_n = 0, s, n; /* of the two points around a time */
  for (char **each = points; *each && sscanf(*each, "%lf:%lf", &s, &n) == 2; each++, before_s = s, before_n = n)
    if (at_s < s) return each == points ? 0 : before_n + (n - before_n) * (at_s - before_s) / (s - before_s);
  return before_n;
}
static void state(void) {
  int is_fresh = !is_latched && answered_ns && now_ns() - answered_at_ns < 50 * MS;
  double session_s = started_ns ? 1e-9 * (now_ns() - started_ns) : -1, pressed[3] = {0, 0, -pressed_n(session_s)};
  begin(STATE, 14); fields("position_m:v reference_m:v velocity_m_per_s:v operator_force_n:v", position, position, still, pressed); fields("motor_force_n:v mode:s estop:b limited:b", is_fresh ? force : still, is_fresh ? mode : "off", is_latched, 0);
  fields("armed:b session_s:d step_s:d answered_seq:i answered_t_ns:i answered_at_ns:i", is_armed, session_s, 1 / rate_hz, answered_seq, answered_ns, answered_at_ns); end(STATE);
}
static void health(double uptime_s) {
  begin(HEALTH, 16); fields("state:s pid:i uptime_s:d rate_hz:d period_s:d", is_latched ? "safe" : "running", (int64_t)getpid(), uptime_s, rate_hz, 1 / rate_hz);
  fields("lateness_p50_s:d lateness_p99_s:d lateness_max_s:d cpu_percent:d overruns:i memory_bytes:i", 0.0, 0.0, 0.0, 0.0, 0LL, 0LL); fields("realtime:b memory_locked:b replay:b rejected:m inputs:a", 0, 0, 0, 0); end(HEALTH);
}
int main(int count, char **words) {
  if (count < 6) return fputs("hand_client OWN_ENDPOINT RIG_ENDPOINT[,RIG_ENDPOINT] SECONDS STOP_AFTER_S RATE_HZ [TIME_S:FORCE_N ...]\n", stderr), 2;
  offset_ns = clock_ns(CLOCK_REALTIME) - now_ns(); run = now_ns() / 1000 & 0xffffffff; rate_hz = atof(words[5]); points = words + 6;
  char line[256]; FILE *keys = getenv("HAND_KEY_FILE") ? fopen(getenv("HAND_KEY_FILE"), "r") : NULL; rig_key = getenv("RIG_KEY");
  while (keys && fgets(line, sizeof line, keys)) sscanf(line, " public-key = \"%40[^\"]", public_key), sscanf(line, " secret-key = \"%40[^\"]", secret_key);
  void *context = zmq_ctx_new(); publisher = zmq_socket(context, ZMQ_PUB); reader = zmq_socket(context, ZMQ_SUB); zap = zmq_socket(context, ZMQ_REP);
  msgpack_sbuffer_init(&buffer); msgpack_packer_init(&packer, &buffer, msgpack_sbuffer_write); const char *read[] = {"haptic/command", "afm/state", topics[CONTROL], topics[EVENT]};
  for (int each = 0; each < 4; each++) zmq_setsockopt(reader, ZMQ_SUBSCRIBE, read[each], strlen(read[each]));
  zmq_setsockopt(publisher, ZMQ_LINGER, &(int){1000}, sizeof(int)); zmq_setsockopt(reader, ZMQ_HEARTBEAT_IVL, &(int){200}, sizeof(int)); secure(publisher, words[1], 1), secure(reader, words[2], 0);
  if (zmq_bind(zap, "inproc://zeromq.zap.01") || zmq_bind(publisher, words[1])) return fprintf(stderr, "%s: %s\n", words[1], zmq_strerror(zmq_errno())), 1;
  for (char *each = strtok(words[2], ","); each; each = strtok(NULL, ",")) if (zmq_connect(reader, each)) return fprintf(stderr, "%s: %s\n", each, zmq_strerror(zmq_errno())), 1;
  int64_t begun = now_ns(), due = begun, period = 1e9 / rate_hz, ends = begun + (int64_t)(1e9 * atof(words[3])), after = 1e9 * atof(words[4]);
  for (int64_t reported = 0, given = 0, wake; due < ends; due += period) {
    wake = due - offset_ns; clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &(struct timespec){wake / 1000000000, wake % 1000000000}, NULL); admit(); read_all();
    state(); if (due >= reported) { health(1e-9 * (now_ns() - begun)); reported = due + 500 * MS; }
    if (!after || now_ns() < begun + after || is_given || due < given) continue;
    if (strcmp(latch, OWN_STOP)) { stop(OWN_STOP); } given = due + 50 * MS; begin(CONTROL, 4); fields("id:s command:s target:s parameters:m", OWN_STOP, "estop", "*", 0); end(CONTROL);
  }
  begin(EVENT, 5); fields("id:s kind:s level:s text:s data:m state:s", "", "node", "info", "the hand has ended", 4, "ended");
  fields("sent.haptic/state:i sent.session/event:i sent.node/health:i", sent[STATE], sent[EVENT], sent[HEALTH]); end(EVENT);
  printf("{\"tip_force_n\": [%.17g, %.17g, %.17g], \"stop_was_heard\": %s}\n", tip[0], tip[1], tip[2], is_given ? "true" : "false");
  return zmq_close(publisher), zmq_close(reader), zmq_close(zap), zmq_ctx_term(context);
}
