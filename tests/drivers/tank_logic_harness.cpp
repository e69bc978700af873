// Runs the board's decisions on a computer. Each line of input: time, leak, full, level, then a command or "-".
// Each line of output: the two pins, then the reply or "-".

#include <iostream>
#include <sstream>
#include <string>

#include "tank_logic.h"

int main() {
  tank::Logic logic;
  std::string line;
  while (std::getline(std::cin, line)) {
    std::istringstream words(line);
    uint32_t now_ms;
    int leak, full, level;
    std::string command;
    words >> now_ms >> leak >> full >> level;
    std::getline(words >> std::ws, command);
    logic.tick(now_ms, {leak != 0, full != 0, static_cast<uint16_t>(level)});
    char reply[144] = "-";
    if (command == "BOOT") {
      logic.greet(reply, sizeof reply);
    } else if (command != "-") {
      logic.command(command == "(empty)" ? "" : command.c_str(), now_ms, reply, sizeof reply);
    }
    std::cout << logic.fill_on() << ' ' << logic.drain_on() << ' ' << reply << std::endl;
  }
}
