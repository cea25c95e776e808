/* A text file of all that a robot's firmware was given and what it made of it, for check_log.py. A line is a
 * word and whole numbers, in the firmware's own units, with commas between:
 *
 *     start,ID,B_HAT,FILTER,FILTER_PERIOD,MEMORY       first line
 *     table,WORD,...                                   second line, if the filter has a t-table
 *     observe,COLOUR
 *     receive,SENDER,X_HAT,ALPHA,STATUS                STATUS is what mcp_asdf_receive() returned
 *     settle,X,X_HAT,ALPHA,B_HAT,STATUS                likewise; the others are the state after it
 */
#ifndef ROBOT_LOG_H
#define ROBOT_LOG_H

#include "mcp_asdf.h"
#include "mcp_asdf_frame.h"

#include <fstream>
#include <string>

class RobotLog
{
  public:
    /* Write a new file FOLDER/ROBOT_NAME.csv, and its first lines. An empty folder's name means no log, and
     * then the other functions do nothing. The folder is made if need be. Throws CARGoSException, also from
     * the other functions, if the file cannot be written. */
    void Start(const std::string &folder, const std::string &robot_name, const mcp_asdf_t &firmware,
               const mcp_asdf_config_t &config);

    void Observe(mcp_asdf_observation_t colour);
    void Receive(const mcp_asdf_estimate_t &estimate, mcp_asdf_status_t status);
    void Settle(const mcp_asdf_t &firmware, mcp_asdf_status_t status);

    /* Complete the file. */
    void Close();

  private:
    void WriteTable(const uint32_t *table);
    void CheckFile() const;

    std::string path_;
    std::ofstream file_;
};

#endif
