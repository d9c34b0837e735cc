// Reads the answers of `tactape-fab watch SOURCE --tape KIT --json | ./read_answers`: one JSON object a line, keys in any order.
// Build: g++ -std=c++17 -O2 -Wall -Wextra -Werror -o read_answers read_answers.cpp
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <string>
#include <vector>

// What stands behind a key of the answer itself, up to the end of the line; empty where it is null or not there.
static std::string value_of(const std::string& line, const std::string& key) {
    const std::string mark = "\"" + key + "\": ";
    const std::size_t at = line.find(mark);
    if (at == std::string::npos || line.compare(at + mark.size(), 4, "null") == 0) return "";
    return line.substr(at + mark.size());
}

// The numbers of a list or matrix, row by row, or one number.
static std::vector<double> numbers_of(const std::string& text, std::size_t count) {
    std::vector<double> found;
    const char* at = text.c_str();
    while (found.size() < count && *at != '\0') {
        char* end = nullptr;
        const double value = std::strtod(at, &end);
        if (end == at) { ++at; continue; }
        found.push_back(value);
        at = end;
    }
    return found;
}

int main() {
    std::string line;
    long answers = 0, located = 0;
    while (std::getline(std::cin, line)) {
        ++answers;
        if (value_of(line, "located").rfind("true", 0) != 0) continue;
        const std::vector<double> place = numbers_of(value_of(line, "position_mm"), 2);
        const std::vector<double> theta = numbers_of(value_of(line, "theta_deg"), 1);
        const std::vector<double> variance = numbers_of(value_of(line, "covariance"), 9);  // of x mm, y mm, theta rad
        if (place.size() != 2 || theta.empty() || variance.size() != 9) return 1;
        std::printf("%.6f %.6f %.6f %.3e\n", place[0], place[1], theta[0], variance[0]);
        std::fflush(stdout);
        ++located;
    }
    std::fprintf(stderr, "%ld answers, %ld located\n", answers, located);
    return 0;
}
