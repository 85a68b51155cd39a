// A plugin of clang-tidy: its matchers see the project's declarations and not those of system headers.
//
// clang-tidy 14 walks the whole of a unit once for all checks, Eigen's, OpenCV's and the library's templates with every
// instance of them included, and drops afterwards what it found there: three quarters of its time. Here the walk is
// bounded before it begins, as clangd bounds its own. The headers are still parsed and stay known to whatever the
// project's code refers to; the static analyzer, which follows functions by their calls, is not touched. Loaded by
// scripts/check_tidy.
#include <memory>
#include <string>
#include <vector>

#include "clang/AST/ASTConsumer.h"
#include "clang/AST/ASTContext.h"
#include "clang/Basic/SourceManager.h"
#include "clang/Frontend/CompilerInstance.h"
#include "clang/Frontend/FrontendAction.h"
#include "clang/Frontend/FrontendPluginRegistry.h"

namespace {

class OwnCode : public clang::ASTConsumer {
 public:
  // Before the consumer of the checks: it begins to walk in its own HandleTranslationUnit.
  void HandleTranslationUnit(clang::ASTContext& context) override {
    const clang::SourceManager& sources = context.getSourceManager();
    std::vector<clang::Decl*> own;
    for (clang::Decl* declaration : context.getTranslationUnitDecl()->decls()) {
      const clang::SourceLocation location = sources.getExpansionLoc(declaration->getLocation());
      // What has no place is the compiler's own.
      if (location.isValid() && !sources.isInSystemHeader(location)) own.push_back(declaration);
    }
    context.setTraversalScope(own);
  }
};

class OwnCodeAction : public clang::PluginASTAction {
 protected:
  std::unique_ptr<clang::ASTConsumer> CreateASTConsumer(clang::CompilerInstance& /*compiler*/,
                                                        llvm::StringRef /*file*/) override {
    return std::make_unique<OwnCode>();
  }
  bool ParseArgs(const clang::CompilerInstance& /*compiler*/, const std::vector<std::string>& /*args*/) override {
    return true;
  }
  ActionType getActionType() override { return AddBeforeMainAction; }
};

const clang::FrontendPluginRegistry::Add<OwnCodeAction> kAdded("own-code",
                                                               "matchers see the project's declarations only");

}  // namespace
