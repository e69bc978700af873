// The decisions of the tank board, without a word of Arduino: times in, states and replies out.
//
// Whatever happens to the computer, the pump stops: no heartbeat for a second, the run time that every start carries,
// a cap on that time, a leak contact or an over-fill contact that opens. Times are those of millis() and may wrap around:
// only differences of unsigned numbers are ever compared.
//
// One line each way, ended by '\n'. Every reply carries the whole state:
//   OK FILL FILLING ran=0 left=30000 fault=none leak=0 full=0 level=512
//   NO FILL IDLE ran=0 left=0 fault=none leak=1 full=0 level=512 why=leak

#ifndef TANK_LOGIC_H
#define TANK_LOGIC_H

#include <stdint.h>
#include <stdio.h>
#include <string.h>

namespace tank {

const uint32_t kHeartbeatMs = 1000;      // longest silence while the pump turns
const uint32_t kLongestRunMs = 1800000;  // no start may ask for more: half an hour
const uint32_t kDebounceMs = 20;         // a contact counts as open after this long; relays make sparks
const char kIdentity[] = "tank-board/1";

enum State { kIdle, kFilling, kDraining };
enum Fault { kNone, kReset, kHeartbeat, kLeak, kFull };

// A contact is closed while all is well: a broken wire then looks like the accident that it cannot report.
struct Inputs {
  bool leak_open;
  bool full_open;
  uint16_t level;
};

class Contact {
 public:
  void sample(bool open, uint32_t now_ms) {
    if (!open) {
      open_ = seen_ = false;
    } else if (!seen_) {
      seen_ = true;
      since_ms_ = now_ms;
    }
    if (seen_ && now_ms - since_ms_ >= kDebounceMs) open_ = true;
  }
  bool open() const { return open_; }

 private:
  bool open_ = false, seen_ = false;
  uint32_t since_ms_ = 0;
};

class Logic {
 public:
  bool fill_on() const { return state_ == kFilling; }
  bool drain_on() const { return state_ == kDraining; }

  // Called on every turn of the main loop, before anything else.
  void tick(uint32_t now_ms, const Inputs& inputs) {
    leak_.sample(inputs.leak_open, now_ms);
    full_.sample(inputs.full_open, now_ms);
    level_ = inputs.level;
    if (state_ != kIdle) {
      ran_ms_ = now_ms - started_ms_;
      if (ran_ms_ >= run_ms_) {
        state_ = kIdle;
      } else if (now_ms - heard_ms_ >= kHeartbeatMs) {
        stop_for(kHeartbeat);
      } else if (state_ == kFilling && full_.open()) {
        stop_for(kFull);
      }
    }
    if (leak_.open()) stop_for(kLeak);  // also while nothing turns: it stays on record until somebody says STOP
  }

  // What the board says by itself when it wakes up.
  void greet(char* reply, size_t size) const { write(reply, size, "OK", "BOOT", ""); }

  // Carry out one line and write the reply, both without the '\n'. Call tick() with the same time first.
  void command(const char* line, uint32_t now_ms, char* reply, size_t size) {
    char verb[8] = "";
    uint32_t time_ms = 0;
    const bool has_time = parse(line, verb, sizeof verb, &time_ms);
    const char* why = "";
    if (!strcmp(verb, "FILL") || !strcmp(verb, "DRAIN")) {
      const bool fill = verb[0] == 'F';
      why = refusal(fill, has_time, time_ms);
      if (!*why) start(fill ? kFilling : kDraining, time_ms, now_ms);
    } else if (has_time) {
      why = "unknown";
      strcpy(verb, "?");
    } else if (!strcmp(verb, "HB")) {
      heard_ms_ = now_ms;
    } else if (!strcmp(verb, "STOP")) {
      state_ = kIdle;
      write(reply, size, "OK", verb, "");  // names the fault that this STOP acknowledges
      fault_ = leak_.open() ? kLeak : kNone;
      return;
    } else if (!strcmp(verb, "ID?")) {
      write(reply, size, "OK", verb, "");
      append(reply, size, " id=", kIdentity);
      return;
    } else if (strcmp(verb, "STATE?") && strcmp(verb, "LEVEL?") && strcmp(verb, "LEAK?")) {
      why = "unknown";
      strcpy(verb, "?");
    }
    write(reply, size, *why ? "NO" : "OK", verb, why);
  }

 private:
  // "FILL 30000" -> verb and true; a line that is anything else leaves the verb "?".
  static bool parse(const char* line, char* verb, size_t size, uint32_t* time_ms) {
    const size_t length = strcspn(line, " ");
    if (length == 0 || length >= size) {
      strcpy(verb, "?");
      return false;
    }
    memcpy(verb, line, length);
    verb[length] = '\0';
    const char* digit = line + length;
    if (*digit == '\0') return false;
    uint32_t value = 0;
    int count = 0;
    for (++digit; *digit >= '0' && *digit <= '9' && count < 9; ++digit, ++count) value = value * 10 + (*digit - '0');
    if (*digit != '\0' || count == 0) {
      strcpy(verb, "?");
      return false;
    }
    *time_ms = value;
    return true;
  }

  const char* refusal(bool fill, bool has_time, uint32_t time_ms) const {
    if (!has_time || time_ms == 0 || time_ms > kLongestRunMs) return "time";
    if (state_ != kIdle) return "busy";
    if (leak_.open()) return "leak";
    if (fill && full_.open()) return "full";
    if (fault_ != kNone) return "fault";  // somebody must say STOP first
    return "";
  }

  void start(State state, uint32_t run_ms, uint32_t now_ms) {
    state_ = state;
    run_ms_ = run_ms;
    ran_ms_ = 0;
    started_ms_ = heard_ms_ = now_ms;
  }

  void stop_for(Fault fault) {
    state_ = kIdle;
    fault_ = fault;
  }

  void write(char* reply, size_t size, const char* answer, const char* verb, const char* why) const {
    static const char* const kStates[] = {"IDLE", "FILLING", "DRAINING"};
    static const char* const kFaults[] = {"none", "reset", "heartbeat", "leak", "full"};
    const uint32_t left_ms = state_ == kIdle ? 0 : run_ms_ - ran_ms_;
    snprintf(reply, size, "%s %s %s ran=%lu left=%lu fault=%s leak=%d full=%d level=%u", answer, verb, kStates[state_],
             (unsigned long)ran_ms_, (unsigned long)left_ms, kFaults[fault_], leak_.open(), full_.open(),
             (unsigned)level_);
    if (*why) append(reply, size, " why=", why);
  }

  static void append(char* reply, size_t size, const char* name, const char* value) {
    const size_t used = strlen(reply);
    snprintf(reply + used, size - used, "%s%s", name, value);
  }

  State state_ = kIdle;
  Fault fault_ = kReset;  // a board that just woke up says so until somebody says STOP
  Contact leak_, full_;
  uint16_t level_ = 0;
  uint32_t started_ms_ = 0, heard_ms_ = 0, run_ms_ = 0, ran_ms_ = 0;
};

}  // namespace tank

#endif
