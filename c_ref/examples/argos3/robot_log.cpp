#include "robot_log.h"

#include <argos3/core/utility/configuration/argos_exception.h>

#include <filesystem>
#include <system_error>

using namespace argos;

void RobotLog::Start(const std::string &folder, const std::string &robot_name, const mcp_asdf_t &firmware,
                     const mcp_asdf_config_t &config)
{
    Close();
    if (folder.empty()) {
        return;
    }
    std::error_code ignored; /* without the folder the file cannot be opened, which is reported */
    std::filesystem::create_directories(folder, ignored);
    path_ = folder + "/" + robot_name + ".csv";
    file_.open(path_, std::ios::trunc);
    file_ << "start," << unsigned{mcp_asdf_id(&firmware)} << ',' << mcp_asdf_b_hat(&firmware) << ','
          << unsigned{config.filter} << ',' << config.filter_period << ',' << config.memory << '\n';
    if (config.filter == MCP_ASDF_ADAPTIVE) {
        WriteTable(config.table);
    }
    CheckFile();
}

void RobotLog::WriteTable(const uint32_t *table)
{
    /* Two words and q thresholds, q being the lowest byte of the first word, and a checksum. */
    const uint32_t word_count = (table[0] & 0xFFU) + 3U;
    file_ << "table";
    for (uint32_t index = 0; index < word_count; ++index) {
        file_ << ',' << table[index];
    }
    file_ << '\n';
}

void RobotLog::Observe(mcp_asdf_observation_t colour)
{
    if (file_.is_open()) {
        file_ << "observe," << colour << '\n';
    }
}

void RobotLog::Receive(const mcp_asdf_estimate_t &estimate, mcp_asdf_status_t status)
{
    if (file_.is_open()) {
        file_ << "receive," << unsigned{estimate.node} << ',' << estimate.x_hat << ',' << estimate.alpha
              << ',' << status << '\n';
    }
}

void RobotLog::Settle(const mcp_asdf_t &firmware, mcp_asdf_status_t status)
{
    if (file_.is_open()) {
        file_ << "settle," << mcp_asdf_x(&firmware) << ',' << mcp_asdf_x_hat(&firmware) << ','
              << mcp_asdf_alpha(&firmware) << ',' << mcp_asdf_b_hat(&firmware) << ',' << status << '\n';
        CheckFile();
    }
}

void RobotLog::Close()
{
    if (file_.is_open()) {
        file_.close();
        CheckFile();
    }
}

void RobotLog::CheckFile() const
{
    if (!file_) {
        THROW_ARGOSEXCEPTION("cannot write " << path_
                                             << "; give another log_folder, or make room on the disk");
    }
}
